"""Where tables begin and end in texts and workbooks."""

from datetime import date, datetime, timedelta

import numpy as np
import openpyxl
import pyarrow as pa
import pytest

from palpate.estimation.data.file_columns import FileColumns
from palpate.estimation.data.import_file import import_file, import_table
from palpate.estimation.data.table import read_table, table_of
from palpate.estimation.data.table_layout import find_tests
from palpate.robot_io.errors import InputError

NAMES = ("Time [s]", "Travel [mm]", "Load [N]")
T = 1.0 + 0.25 * np.arange(12)


@pytest.fixture
def book(tmp_path):
    """Writes a workbook from the rows of each sheet."""

    def write(**sheets):
        made = openpyxl.Workbook()
        made.remove(made.active)
        for title, rows in sheets.items():
            sheet = made.create_sheet(title)
            for row in rows:
                sheet.append(row)
        made.save(tmp_path / "book.xlsx")
        return tmp_path / "book.xlsx"

    return write


def test_numbers_are_the_same_beside_text_with_decimal_commas(book):
    rows = [[1.0 + 0.125 * i, 1.125 + i, f"{0.5 * i:.5f}".replace(".", ",")] for i in range(9)]
    short = [row + (row if place < 6 else [None] * 3) for place, row in enumerate(rows)]
    for sheet in ([NAMES, *rows[:4], [1.5, "5,125", "2,0"], *rows[5:]], [NAMES * 2, *short]):
        table = read_table(book(S=sheet))
        truth = np.r_[np.arange(9), np.arange(len(table) - 9)]
        np.testing.assert_array_equal(table.numbers("Time [s]"), 1.0 + 0.125 * truth)
        np.testing.assert_array_equal(table.numbers("Travel [mm]"), 1.125 + truth)
        np.testing.assert_array_equal(table.numbers("Load [N]"), 0.5 * truth)


def test_misplaced_points_are_no_thousands_separators(tmp_path):
    path = tmp_path / "mixed.csv"
    path.write_text(";".join(NAMES) + "\n" + "".join(f"{i / 8:.3f};{i},25;{i},5\n" for i in range(12)))
    np.testing.assert_array_equal(read_table(path).numbers("Time [s]"), np.arange(12) / 8)


@pytest.mark.parametrize("gap", [None, np.nan])
def test_tests_of_a_frame_may_differ_in_length_and_number_type(tmp_path, gap):
    filled = [np.r_[(i + 1.0) * T[:8], [np.nan] * 4] for i in range(3)]
    short = [pa.array(one, from_pandas=gap is None) for one in filled]
    whole = [pa.array(np.arange(12)), pa.array(T), pa.array(2.0 * T)]
    names = [f"{name.split()[0]} {n} {name.split()[1]}" for n in "12" for name in NAMES]
    table = table_of(FileColumns(pa.table([*whole, *short], names=names)), tmp_path)
    assert len(table) == 20
    np.testing.assert_array_equal(table.numbers("Time [s]"), np.r_[np.arange(12), T[:8]])
    assert len(import_table(table).channels[0].runs) == 2


@pytest.mark.parametrize(
    "kind", [pa.timestamp("us"), pa.large_string(), pa.dictionary(pa.int16(), pa.string())]
)
def test_times_of_a_frame_are_seconds(tmp_path, kind):
    stamps = [datetime(2024, 3, 1, 23, 59, 59) + timedelta(seconds=0.25 * row) for row in range(12)]
    times = pa.array(
        stamps if pa.types.is_timestamp(kind) else [f"{one:%Y-%m-%d %H:%M:%S.%f}" for one in stamps]
    )
    columns = pa.table([times.cast(kind), pa.array(T), pa.array(T)], names=["Time", *NAMES[1:]])
    table = table_of(FileColumns(columns), tmp_path)
    np.testing.assert_allclose(table.numbers("Time") - 86399.0, 0.25 * np.arange(12), atol=1e-6)


def test_repeated_names_in_another_order_keep_their_columns(book):
    first, other = NAMES, (NAMES[1], NAMES[0], NAMES[2])
    rows = [[[t, 2 * t, k * t, t, 3 * t, (k + 1) * t] for t in T] for k in (4, 6)]
    rows[1] = [[row[place] for place in (1, 0, 2, 4, 3, 5)] for row in rows[1]]
    table = read_table(book(A=[first * 2, *rows[0]], B=[other * 2, *rows[1]]))
    names, index = table.labels("run")
    for run, (way, load) in {"A 1": (2, 4), "B 1": (2, 6), "A 2": (3, 5), "B 2": (3, 7)}.items():
        one = table.select(index == names.index(run))
        np.testing.assert_allclose(one.numbers("Travel [mm]"), way * one.numbers("Time [s]"))
        np.testing.assert_allclose(one.numbers("Load [N]"), load * one.numbers("Time [s]"))


@pytest.mark.parametrize("tests", [1, 2])
def test_runs_of_different_sheets_are_separate(book, tests):
    rows = [
        [cell for test in range(tests) for cell in (1 + row // 6, t, 2 * t, (3 + test) * t)]
        for row, t in enumerate(T)
    ]
    later = [[cell + 100.0 * (place % 4 == 1) for place, cell in enumerate(row)] for row in rows]
    path = book(A=[("run", *NAMES) * tests, *rows], B=[("run", *NAMES) * tests, *later])
    labels = [f"{run} {sheet}" for sheet in "AB" for run in (1, 2)]
    expected = labels if tests == 1 else [f"{label} {test}" for test in (1, 2) for label in labels]
    assert sorted(import_file(path).run_labels.values()) == sorted(expected)


@pytest.mark.parametrize(
    "start", [datetime(2024, 3, 1, 23, 59, 59), timedelta(hours=23, minutes=59, seconds=59)]
)
def test_cell_times_continue_past_midnight(book, start):
    rows = [[start + timedelta(seconds=0.25 * row), 2.0 * row, 3.0 * row] for row in range(12)]
    table = read_table(book(S=[("Time", *NAMES[1:]), *rows]))
    np.testing.assert_allclose(table.numbers("Time") - 86399.0, 0.25 * np.arange(12), atol=1e-6)


def test_formulas_without_results_are_empty_and_dates_stay_dates(book):
    names = ("time_s", "displacement_m", "force_N")
    path = book(S=[names, *([t, 4e-3 * t, "=B2*2"] for t in T.tolist())])
    with pytest.raises(
        InputError, match=r"column 'force_N' is empty; .*--column, or, if the cells hold formulas"
    ):
        import_file(path)
    rows = [[date(2024, 3, 2), t, 2 * t, 3 * t] for t in T]
    assert set(read_table(book(S=[("Made", *NAMES), *rows])).labels("Made")[0]) == {"2024-03-02"}


HEAD = "Time [s],Travel [mm],Load [N]"
ROWS = [f"{i / 8},{i},{2 * i}" for i in range(9)]


@pytest.fixture
def read(tmp_path):
    """Writes a text and reads it."""

    def reader(text):
        path = tmp_path / "tests.csv"
        path.write_bytes(text.encode())
        return read_table(path)

    return reader


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("footer", [[], ["", ",,", "Mean,7"]])
def test_lines_may_end_in_any_way(read, end, footer):
    table = read(end.join([HEAD, *ROWS, "", HEAD, *ROWS, *footer, ""]))
    np.testing.assert_array_equal(table.numbers("Load [N]"), np.tile(2.0 * np.arange(9), 2))
    assert len(table.labels("run")[0]) == 2
    notes = {"a footer of 1 line", "1 empty row at the end left out"}
    assert notes.issubset(table.notes) is bool(footer)


@pytest.mark.parametrize("behind", ["\r\n", " \n", "\t \r\n"])
def test_trailing_blanks_do_not_change_a_header(read, behind):
    table = read("\n".join([HEAD, *ROWS, HEAD]) + behind + "\n".join(ROWS))
    assert len(table.labels("run")[0]) == 2
    assert len(table) == 18


def test_words_below_a_header_are_named_as_no_numbers(read):
    with pytest.raises(InputError, match="line 2, column 'force_N': 'c' is not a finite number"):
        read("time_s,displacement_m,force_N\na,b,c\n").numbers("force_N")


@pytest.mark.parametrize("cut", ["5.99,,", "5.99,", ",1,"])
def test_row_without_its_last_numbers_is_no_footer(read, cut):
    with pytest.raises(InputError, match="line 11"):
        read("\n".join([HEAD, *ROWS, cut])).numbers("Load [N]")


@pytest.mark.parametrize(
    ("names", "tests"),
    [
        (["Time", "Kanal A", "Kanal B"] * 2, 2),  # unknown names may hold anything
        (["Time", "Force", "Travel"] * 2, 2),
        (["Time", "Force", "Travel", "Force"], 0),  # a column that was written twice
    ],
)
def test_side_by_side_tests_repeat_a_motion_and_an_effort(names, tests):
    assert len(find_tests(names)) == tests


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("units", ["in names", "behind names"])
def test_signals_in_rows_are_read(tmp_path, delimiter, units):
    path, decimal = tmp_path / "rows.csv", "," if delimiter == ";" else "."
    lines = []
    for name, values in zip(NAMES, (T, 2.0 * T, 3.0 * T), strict=True):
        begin = [name] if units == "in names" else name.rstrip("]").split(" [")
        lines.append(delimiter.join([*begin, *(f"{value:.2f}".replace(".", decimal) for value in values)]))
    path.write_text("\n".join(lines))
    table = read_table(path)
    np.testing.assert_allclose([table.numbers(name) for name in NAMES], [T, 2.0 * T, 3.0 * T])
    assert "each row holds a signal" in table.notes
    assert table.row_name(0) == f"column {2 if units == 'in names' else 3}"


def test_signals_in_rows_without_names_are_explained(tmp_path):
    np.savetxt(tmp_path / "rows.txt", [T, 2.0 * T, 3.0 * T] @ np.ones((len(T), 5 * len(T))))
    with pytest.raises(
        InputError, match="has 3 rows and 60 columns without names, so each row seems to hold a"
    ):
        import_file(tmp_path / "rows.txt")


def test_signals_in_rows_of_a_sheet_are_read(book):
    path = book(S=[[name, *(factor * T)] for factor, name in enumerate(NAMES, 1)])
    table = read_table(path)
    np.testing.assert_allclose([table.numbers(name) for name in NAMES], [T, 2.0 * T, 3.0 * T])
    assert "each row holds a signal" in table.notes
    assert table.row_name(0) == "column 2"


def test_sheets_without_names_or_numbers_are_listed(book):
    rows = [[float(n), 2.0 * n, 3.0 * n] for n in range(9)]
    table = read_table(book(Named=[NAMES, *rows[:5]], Raw=rows, Notes=[["by", "hand"]]))
    assert len(table) == 5
    assert "'Raw' (9 rows); --table Raw reads one" in "; ".join(table.notes)
    assert len(read_table(table.path, "Raw")) == 9
    table = read_table(book(Named=[NAMES, *rows[:5]], Raw=[["Time", None, None], *rows]))
    assert "'Raw' (9 rows); --table Raw reads one" in "; ".join(table.notes)
    assert read_table(table.path, "Raw").row_name(0) == "row 2"
    with pytest.raises(InputError, match=r"Available: Named, Raw$"):
        read_table(table.path, "Other")
    beside = [[*row, "note" if n % 2 else 1.0] for n, row in enumerate(rows)]
    with pytest.raises(InputError, match=r"--table Beside: .*in this sheet, no row of column names is"):
        read_table(book(Named=[NAMES, *rows], Beside=beside), "Beside")
    with pytest.raises(InputError, match=r"Its sheets: 'Notes', 'More'$"):
        read_table(book(Notes=[["by", "hand"]], More=[["x"]]))
    with pytest.raises(InputError, match=r"; not read.*'Wide' \(4 rows\); --table Wide"):
        import_file(book(Raw=rows, Wide=[[*row, 1.0] for row in rows[:4]]))


NUMBERS = [[i, 0.5 * i, 0.25 * i] for i in range(9)]


@pytest.mark.parametrize(
    "above",
    [
        [["Foam"], ["by", "hand"], NAMES],
        [["Foam", "of", "two"], ["by", "the", "hand"], NAMES],
        [NAMES, ["Test 1 of foam"]],
        [NAMES, [], ["Raw data:"], []],
        [NAMES, ["Ch1", "Ch2", "Ch3"]],
        [NAMES, ["Ch1", "Ch2", "Ch3"], ["raw", "raw", "cal"]],
        [["Time [s]", "Foam", ""], ["", "Travel [mm]", "Load [N]"]],
        [["Time [s]", "", ""], ["", "Foam", ""], ["", "Travel [mm]", "Load [N]"]],
    ],
)
def test_names_are_found_above_and_below_rows_of_other_words(tmp_path, book, above):
    path = tmp_path / "press.csv"
    path.write_text("".join(",".join(map(str, row)) + "\n" for row in [*above, *NUMBERS]))
    for table in (read_table(path), read_table(book(S=[*above, *NUMBERS]))):
        assert table.names == NAMES
        assert len(table) == len(NUMBERS)


@pytest.mark.parametrize("between", [[], ["", "", "", "", "", ""], ["by hand", "", "", "by hand", "", ""]])
def test_tests_side_by_side_are_named_by_the_nearest_titles(tmp_path, between):
    path = tmp_path / "press.csv"
    numbers = [[*row, row[0], 2.0 * row[1], row[2]] for row in NUMBERS]
    rows = [["Foam", "", "", "Steel", "", ""], between, NAMES * 2, *numbers]
    path.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
    assert read_table(path).labels("run")[0] == ("Foam", "Steel")


def test_titles_of_other_columns_do_not_prevent_names_of_tests(book):
    rows = [[*row, row[0], 2.0 * row[1], row[2], None] for row in NUMBERS]
    titles = ["Foam", "", "", "Steel", "", "", "Cork"]
    table = read_table(book(S=[titles, [*NAMES, *NAMES, "later"], *rows]))
    assert table.labels("run")[0] == ("Foam", "Steel")
