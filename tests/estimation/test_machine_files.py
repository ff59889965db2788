"""Layouts of files as testing machines write them: the longest table is read, whatever stands around it."""

import warnings

import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_files import data_files, import_files
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import read_table
from palpate.robot_io.errors import InputError
from tests.estimation.press_tables import FORCE_N, HEADER, TIME_S, WAY_M, check_press, rows
from tests.files import saved

RESULTS = "Results 1,,,\n,Gauge length,Maximum force,Note\n,(mm),(N),\n1,9.5,31.2,\n2,9.7,30.5,\n,,,\n"
NAMES = "Time,Displacement,Force\n"
LINES = rows().splitlines(keepends=True)
COUNTED = "".join(f"{at},{line}" for at, line in enumerate(LINES, 1))
PRESS = list(zip(TIME_S, 1e3 * WAY_M, FORCE_N, strict=True))

LAYOUTS = {
    "results above, headers numbered": RESULTS
    + "".join(f"{n},{NAMES},(s),(mm),(N)\n" + rows(before=",") for n in (1, 2)),
    "units of products": "Way\tForce\tTorque\tTime\nmm\tN\tkN·mm\tsec\n"
    + "".join(f"{x:.6f}\t{f:.6f}\t0\t{t:.6f}\n" for t, x, f in PRESS),
    "units above names": "(s),(mm),(N)\n" + NAMES + rows(),
    "units alone": "s;mm;N\n" + rows(";", ","),
    "units in a comment": "% Time,Load cell,Way,Goal\n% [s],[N],[mm],[mm]\n"
    + "".join(f"{t},{f},{x:.6f},3\n" for t, x, f in PRESS),
    "units in brackets between blanks": "Raw Data\nTime Displacement Force\n(s) (mm) (N)\n" + rows(" "),
    "quoted": '"Operator","A, B"\n\n"Time","Extension","Load"\n"(s)","(mm)","(N)"\n\n' + rows(),
    "grams, and the force first": "Force\tDistance\tTime\n(g)\t(mm)\t(sec)\n"
    + "".join(f"{f / 9.80665e-3:.6f}\t{x:.6f}\t{t:.6f}\n" for t, x, f in PRESS),
    "pounds and inches of numbered readings": (
        "Serial Number:,3456789\nDate:,2024-05-02\n\nReading,Load [lbF],Travel [in],Time [s]\n"
    )
    + "".join(f"{n},{f / 4.4482216:.9f},{x / 25.4:.9f},{t}\n" for n, (t, x, f) in enumerate(PRESS, 1)),
    "words around the names": (
        "MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\nData Acquisition: Timed\t\t\tTime:\t12.5\tSec\n"
        "Running Time (msec)\tAxial Displacement (mm)\tAxial Force (mN)\t\n"
    )
    + "".join(f"{1e3 * t:.6f}\t{x:.6f}\t{1e3 * f:.6f}\t\n" for t, x, f in PRESS),
    "a mark below the names": "Routine\n\n" + HEADER + "eoh\n" + rows(),
    "names over two lines": '"Time\n[s]","Way\r\n(mm)","Force\n[N]"\n' + rows(),
    "dashes below names": "Time [s]  Way [mm]  Force [N]\n--------  --------  ---------\n" + rows("  "),
    "a channel below a name": "Time (s),Travel (mm),Load (N)\n,,Channel 2\n" + rows(),
    "trailing columns": "Time [s];Weg [mm];Kraft [N];;\n" + rows(";", ",", behind=";;"),
    "slashes": "Zeit / s\tWeg / mm\tKraft / N\n" + rows("\t", ","),
    "statistics below": "Time_s,Travel_mm,Force_N\n" + rows() + "Mean,1,2\nDeviation,3,4\n",
    "Zwick": '"Prüfzeit";"Standardweg";"Standardkraft"\n"s";"mm";"N"\n' + rows(";", ","),
    "metadata between tests": "".join(
        f"Specimen {n}\nOperator,AB\n\n{NAMES}sec,mm,N\n{rows()}\n" for n in (1, 2, 3)
    ),
    "quoted decimal commas": '"Zeit (s)","Weg (mm)","Kraft (N)"\n"'
    + rows('","', ",", behind='"').replace("\n", '\n"')[:-1],
    "a column twice": "Time [s],Travel [mm],Load [N],E [GPa],E [GPa]\n" + rows(behind=",1,2"),
    "a long preamble": "Remark: none\n" * 700 + HEADER + rows(),
    "rows shorter than the header": HEADER.replace("\n", ",Remark,Operator\n")
    + "".join(line.replace("\n", ",ok,AB\n") if at % 3 == 0 else line for at, line in enumerate(LINES)),
    "counted rows": HEADER + COUNTED,
    "named rows": HEADER + "".join(f"row{at},{line}" for at, line in enumerate(LINES)),
    "as R writes it": '"Time (s)" "Extension (mm)" "Load (N)"\n'
    + "".join(f'"{at}" {line}'.replace(",", " ") for at, line in enumerate(LINES, 1)),
    "settings between names and numbers": (
        "Name,Time,Extension,Load\nUnit,s,mm,N\nRange,100,10,500\nFilter,1,2,2\n" + COUNTED
    ),
    "numbers above the names": "Rate,100,Hz\nSpecimen,5,3,7\nArea,12.5,mm\n" + HEADER + rows(),
    **{
        names: names + "\n" + rows()
        for names in (
            *("Time:s,Extension:mm,Load:N", "Time|s,Extension|mm,Load|N"),
            "时间（s）,位移（mm）,力（N）",
        )
    },
    **{
        names: names + "\n" + rows(";", ",")  # a comma before a unit separates no cells
        for names in ("Time, s;Extension, mm;Load, N", "время, с;перемещение, мм;сила, Н")
    },
}
TESTS = {"results above, headers numbered": 2, "metadata between tests": 3}
ENCODINGS = [("quoted", "utf-8-sig"), ("slashes", "utf-16"), ("Zwick", "cp1252")]


@pytest.mark.parametrize(("layout", "encoding"), [*((layout, "utf-8") for layout in LAYOUTS), *ENCODINGS])
def test_press_is_read_from_any_layout(tmp_path, layout, encoding):
    imported = import_file(saved(tmp_path / "press.txt", LAYOUTS[layout].encode(encoding)))
    check_press(imported, TESTS.get(layout, 1))
    np.testing.assert_allclose(np.diff(imported.channels[0].time_s[:600]), np.diff(TIME_S), atol=3e-4)


@pytest.mark.parametrize("name", ["press", "press.prn", "press.xls"])
def test_text_is_read_with_any_file_ending(tmp_path, name):
    path = saved(tmp_path / name, "Time [s]\tTravel [mm]\tLoad [N]\n" + rows("\t"))
    np.testing.assert_allclose(import_file(path).channels[0].effort, FORCE_N, atol=1e-5)


def test_matlab_structs_matrices_and_cells_give_columns(tmp_path):
    data = {"time_s": TIME_S, "displacement_mm": 1e3 * WAY_M, "force_N": FORCE_N, "area": 3.0}
    savemat(tmp_path / "press.mat", {"press": {"data": data}, "rate": 250.0, "gains": [1.0, 2.0]})
    (channel,) = import_file(tmp_path / "press.mat").channels
    np.testing.assert_allclose(channel.effort, FORCE_N)
    savemat(tmp_path / "empty.mat", {"rate": 250.0, "maps": {"torque": np.eye(9)}, "all": np.ones((2, 3, 4))})
    held = r"vectors, only rate \(one number\), maps \(a struct\), all \(numbers of shape \(2, 3, 4\)\);"
    with pytest.raises(InputError, match=held):
        import_file(tmp_path / "empty.mat")
    savemat(tmp_path / "empty.mat", {"operator": "unknown"})
    with pytest.raises(InputError, match=r"holds no vectors, only operator \(text\); a measurement"):
        import_file(tmp_path / "empty.mat")
    twice = (tmp_path / "empty.mat").read_bytes()
    saved(tmp_path / "empty.mat", twice + twice[128:])  # a variable of the same name, without another header
    with warnings.catch_warnings(action="error"), pytest.raises(InputError, match="only operator"):
        import_file(tmp_path / "empty.mat")
    savemat(tmp_path / "empty.mat", {})
    with pytest.raises(InputError, match="holds no vectors; a measurement needs"):
        import_file(tmp_path / "empty.mat")
    columns = np.column_stack([TIME_S, 1e3 * WAY_M, FORCE_N])
    savemat(tmp_path / "press.mat", {"data": columns, "other": TIME_S, "transform": np.eye(4)})
    called = {"time": "data 1", "displacement": "data 2", "force": "data 3"}
    options = ImportOptions(columns=called, units={"time": "s", "displacement": "mm", "force": "kip"})
    (channel,) = import_file(tmp_path / "press.mat", options).channels
    np.testing.assert_allclose(channel.effort, 4448.2216 * FORCE_N, rtol=1e-6)
    rows_of = np.stack([1e3 * WAY_M, FORCE_N])
    cells = np.empty(len(TIME_S), dtype=object)
    cells[:] = list(rows_of.T)
    savemat(tmp_path / "arm.mat", {"time_s": TIME_S, "recorded": rows_of, "cells": cells})
    table = read_table(tmp_path / "arm.mat")
    assert table.names == ("time_s", "recorded 1", "recorded 2", "cells 1", "cells 2")
    np.testing.assert_allclose(table.numbers("cells 2"), FORCE_N)
    np.testing.assert_allclose(table.numbers("recorded 2"), FORCE_N)


@pytest.mark.parametrize(("gap_s", "runs"), [(0.0, 1), (5.0, 2)])
def test_pages_of_one_recording_are_one_run(tmp_path, gap_s, runs):
    path, half = tmp_path / "pages.dat", len(TIME_S) // 2
    written = rows().splitlines(keepends=True)
    head = "Time [s],Travel [mm],Load [N]\n"
    later = [
        f"{time_s + gap_s},{line.split(',', 1)[1]}" for time_s, line in zip(TIME_S, written, strict=True)
    ]
    path.write_text(head + "".join(written[:half]) + "\n" + head + "".join(later[half:]))
    (channel,) = import_file(path).channels
    assert (len(channel), len(channel.runs)) == (len(TIME_S), runs)


def test_null_bytes_and_blank_lines_do_not_spoil_a_table(tmp_path):
    path = tmp_path / "gel.csv"
    lines = rows().splitlines(keepends=True)
    text = "C:\\data\\gel.csv\0\nTime [s],Travel [mm],Load [N]\n" + "".join(
        [*lines[:50], "\0\0  \n", *lines[50:]]
    )
    path.write_bytes(text.encode())
    np.testing.assert_allclose(import_file(path).channels[0].effort, FORCE_N, atol=1e-5)


@pytest.mark.parametrize("place", [0, 1, 2, -1], ids=["before", "for the point", "inside", "behind"])
def test_zero_byte_in_a_number_never_makes_another_number(tmp_path, place):
    """A byte that a disk lost: closing the gap would read 9.876543 as 9876543, or as 9.87654."""
    path, lines = tmp_path / "gel.csv", rows().splitlines()
    time, way, _ = lines[100].split(",")
    force = "9.876543"
    damaged = force[:place] + "\0" + {0: force, -1: ""}.get(place, force[place + 1 :])
    lines[100] = f"{time},{way},{damaged}"
    path.write_text("Time [s],Travel [mm],Load [N]\n" + "\n".join(lines))
    with pytest.raises(InputError, match=r"line 102, column 'Load \[N\]': '.*' is not a finite number"):
        import_file(path)


def test_rows_below_a_line_of_words_are_counted_and_the_line_is_named(tmp_path):
    path = tmp_path / "press.csv"
    lines = [f"{line},0" for line in rows().splitlines()]
    path.write_text("\n".join(["Time [s],Way [mm],Force [N],run", *lines[:50], "a,b,c,d", *lines[50:], ""]))
    note = f"'52' ({len(lines) - 50} rows); --table 52 reads one; if line 52 names no columns, remove it"
    assert note in import_file(path).read


def test_columns_are_counted_in_the_whole_first_line_and_bounded(tmp_path):
    """The dialect is found in the first 256 KiB, and such a line is longer."""
    path, further = tmp_path / "wide.csv", 40_000
    names = ["time_s", "displacement_mm", "force_N", *(f"channel{n}" for n in range(further))]
    cells = [line + ",1" * further for line in rows().splitlines()[200:206]]
    path.write_text("\n".join([",".join(names), *cells, ""]))
    assert len(path.read_text().splitlines()[0]) > 1 << 18
    with pytest.raises(InputError, match=r"has 40,003 columns, but at most 20,000"):
        read_table(path)


def test_lines_keep_their_numbers_below_names_over_two_lines(tmp_path):
    path = tmp_path / "press.csv"
    path.write_text('"Time\n[s]","Way [mm]","Force\n[N]"\n' + rows() + "1.5,2,x\n1.6,2,3\n")
    with pytest.raises(InputError, match=f"line {len(TIME_S) + 4}, column 'Force .N.': 'x'"):
        import_file(path)


def test_other_tables_are_named_with_the_option_that_selects_them(tmp_path):
    path = tmp_path / "press.csv"
    path.write_text(
        "Time [s],Way [mm],Force [N]\n" + rows() + "\n\nTime [s],Heat [K],Force [N]\n1,2,3\n2,3,4\n"
    )
    line = str(4 + len(TIME_S))
    assert (
        f"not read, because the columns differ: line '{line}' (2 rows); --table {line} reads one; "
        f"if line {line} names no columns, remove it"
    ) in import_file(path).read
    columns = {"displacement_mm": "Heat [K]"}
    with pytest.raises(InputError, match="has 2 rows, but at least 5"):
        import_file(path, ImportOptions(table=line, columns=columns))
    with pytest.raises(InputError, match=f"no such table. Available: 1, {line}"):
        import_file(path, ImportOptions(table="2"))


def test_two_tables_of_one_sheet_are_runs(tmp_path):
    book = openpyxl.Workbook()
    for _ in range(2):
        book.active.append(["Time [s]", "Way [mm]", "Load [N]"])
        for t, x, f in zip(TIME_S, WAY_M, FORCE_N, strict=True):
            book.active.append([t, 1e3 * x, f])
        book.active.append(["end of the test"])
    book.save(tmp_path / "tests.xlsx")
    (channel,) = import_file(tmp_path / "tests.xlsx").channels
    assert len(channel.runs) == 2
    np.testing.assert_allclose(channel.position, np.tile(WAY_M, 2), atol=1e-12)


@pytest.mark.parametrize("mark", [",", " ", "\t"])
@pytest.mark.parametrize("names", [HEADER, ""])
def test_blocks_between_comments_are_runs_of_one_table(tmp_path, mark, names):
    """The first block is longer than the lines in which names are looked for."""
    path, lines = tmp_path / "press.txt", rows(mark).splitlines(keepends=True)
    lines *= 1 + 420 // len(lines)
    text = names.replace(",", mark) + "".join(f"# run {n}\n" + "".join(lines) for n in range(3))
    path.write_text(text + "# end\n")
    table = read_table(path)
    assert len(table) == 3 * len(lines)
    assert table.labels("run")[0] == ("1", "2", "3")
    assert table.names[0] == ("Time [s]" if names else "column 1")
    assert ("no names of columns" in table.notes) == (not names)


@pytest.mark.parametrize("single", [[], [*LINES[50:51], "# end of pause\n"]])
def test_comment_inside_a_recording_does_not_divide_it(tmp_path, single):
    path = tmp_path / "press.csv"
    rest = LINES[51:] if single else LINES[50:]
    path.write_text(HEADER + "".join([*LINES[:50], "# pause\n", "\n", *single, *rest]))
    table = read_table(path)
    assert len(table) == len(LINES)
    assert "run" not in table.names
    assert table.row_name(50) == "line 54"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("Force unit: kN", "add --unit force=kN"),
        ("Weg in um; Force [mN]", "add --unit force=mN"),
        ("Units: time ms, displacement mm", "add --unit time=ms"),
        ("Force limit: 5 kN", ""),
        ("Force [kN],5", ""),
        ("Max. force [kN]", ""),
        ("Force in N", ""),
    ],
)
def test_unit_above_the_header_that_contradicts_a_column_is_reported(tmp_path, line, said):
    path = tmp_path / "press.csv"
    path.write_text(f"{line}\n{HEADER}{rows()}")
    notes = " ".join(import_file(path).notes)
    assert said in notes
    assert ("contradicts" in notes) == bool(said)


def test_unit_above_the_header_is_proposed_for_a_column_without_unit(tmp_path):
    path = tmp_path / "press.csv"
    path.write_text(f"Force unit: kN\n{HEADER.replace('[N]', '')}{rows()}")
    with pytest.raises(InputError, match=r"--unit force=kN$"):
        import_file(path)


def test_deflection_of_a_cantilever_is_subtracted_from_the_displacement_of_its_base(tmp_path):
    base = 1e3 * WAY_M + 20.0 * FORCE_N / 1e3
    cells = zip(TIME_S, base, 20.0 * FORCE_N, FORCE_N, strict=True)
    text = "".join(f"{t:.3f},{z:.6f},{d:.3f},{f:.5f}\n" for t, z, d, f in cells)
    path = tmp_path / "cell.csv"
    path.write_text("Time [s],Z piezo [um],Deflection [nm],Force [nN]\n" + text)
    imported = import_file(path)
    np.testing.assert_allclose(imported.channels[0].position, 1e-6 * 1e3 * WAY_M, atol=3e-12)
    assert "the displacement is 'Z piezo [um]' minus 'Deflection [nm]'" in imported.notes[0]
    alone = import_file(path, ImportOptions(columns={"displacement": "Deflection [nm]"}))
    assert "'Deflection [nm]' is proportional to 'Force [nN]' except for rounding" in alone.notes[0]


def test_other_displacement_is_named(tmp_path):
    path = tmp_path / "press.csv"
    lines = [f"{line},{2.0 * way:.6f}" for line, way in zip(rows().splitlines(), WAY_M, strict=True)]
    path.write_text("Time [s],Crosshead [mm],Force [N],LVDT [mm]\n" + "\n".join(lines))
    assert "'Crosshead [mm]' is read as the displacement, not 'LVDT [mm]'" in import_file(path).notes[0]


def test_text_without_numbers_beside_data_files_is_left_out(tmp_path):
    for name in ("1.csv", "2.csv"):
        (tmp_path / name).write_text(HEADER + rows())
    (tmp_path / "readme.txt").write_text("Foam at 4 speeds.\nOperator: A\n")
    imported = import_files(data_files(tmp_path), ImportOptions())
    assert "readme.txt: left out, because it has no numbers" in imported.notes
    assert len(imported.run_labels) >= 2
    alone = import_files([tmp_path / "1.csv", tmp_path / "readme.txt"], ImportOptions())
    assert "readme.txt: left out, because it has no numbers" in alone.notes
    (tmp_path / "named.txt").write_text(f"Specimen,{HEADER}" + "".join(f"steel,{line}" for line in LINES))
    both = import_files([tmp_path / "1.csv", tmp_path / "named.txt"], ImportOptions())
    assert any(label.startswith("named.txt") for label in both.run_labels.values())


def test_fields_of_several_structs_are_named_by_their_structs(tmp_path):
    structs = {name: {"Time": TIME_S, "Data": data} for name, data in (("force", FORCE_N), ("way", WAY_M))}
    savemat(tmp_path / "series.mat", structs)
    names = read_table(tmp_path / "series.mat").names
    assert sorted(names) == ["force.Data", "force.Time", "way.Data", "way.Time"]
    columns, units = {"force": "force.Data", "displacement": "way.Data"}, {"force": "N", "displacement": "m"}
    imported = import_file(tmp_path / "series.mat", ImportOptions(columns=columns, units=units))
    assert "'force.Time' states no unit" in imported.notes[0]  # the times are equal, so either may be read
