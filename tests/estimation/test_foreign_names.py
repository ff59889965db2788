"""Names in other languages and encodings, remarks above tables, and columns without names."""

import openpyxl
import pytest

from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.robot_io.errors import InputError
from tests.estimation.press_tables import by_the_advice, check_press, rows

ROWS = rows().splitlines()


def write(folder, head, rows=ROWS, encoding="utf-8"):
    """A file with these lines, separated by the end of a line."""
    path = folder / "table.csv"
    path.write_bytes("".join(f"{line}\n" for line in [*head, *rows]).encode(encoding))
    return path


@pytest.mark.parametrize(
    "names",
    [
        ("Prüfzeit", "Eindringtiefe", "Prüfkraft"),
        ("Temps", "Déplacement", "Charge"),
        ("Temps", "Allongement des mors", "Force"),
        ("Temps", "Deplacement", "Force"),  # without accents, and with one that stands apart
        ("Temps", "De\u0301placement", "Force"),
        ("Tiempo", "Desplazamiento", "Fuerza"),
        ("Tempo", "Spostamento", "Forza"),
        ("Tempo", "Deslocamento", "Força"),
        ("Czas", "Przemieszczenie", "Siła"),
        ("Время", "Перемещение", "Нагрузка"),
        ("Tijd", "Verplaatsing", "Kracht"),
        ("Süre", "Uzama", "Yük"),
        ("时间", "位移", "力"),
        ("時間", "変位", "試験力"),
        ("시간", "변위", "하중"),
    ],
)
def test_words_of_a_language_choose_among_columns_of_one_unit(tmp_path, names):
    time, way, force = f"{names[0]} (s)", f"{names[1]} (mm)", f"{names[2]} (N)"
    rows = [f"{row},{3 + place % 7},{place}" for place, row in enumerate(ROWS[:50])]
    roles = import_file(write(tmp_path, [f"{time},{way},{force},b0 (mm),Fmax (N)"], rows)).roles
    assert roles == {time: "time in s", way: "displacement in mm", force: "force in N"}


def test_options_accept_the_words_of_columns(tmp_path):
    path = write(tmp_path, ["a,b,c"])
    columns = {"time": "a", "extension": "b", "load": "c"}
    units = {"time": "s", "extension": "mm", "load": "N"}
    check_press(import_file(path, ImportOptions(columns=columns, units=units)))
    with pytest.raises(InputError, match="--column: 'nonsense' is not a quantity"):
        import_file(path, ImportOptions(columns={"nonsense": "b"}))


BY_NUMBER = ImportOptions(
    columns={"time_s": "column 1", "displacement_mm": "column 2", "force_N": "column 3"}
)
SPACED = [row.replace(",", " ") for row in ROWS]


@pytest.mark.parametrize("head", ["# results of the first day of tests", "# kept for the record by all"])
def test_sentence_above_the_numbers_names_no_columns(tmp_path, head):
    path = write(tmp_path, [head], SPACED)
    with pytest.raises(InputError, match="the file has no column names"):
        import_file(path)
    check_press(import_file(path, BY_NUMBER))


@pytest.mark.parametrize(
    ("head", "encoding"),
    [
        ("时间(s),位移(mm),力(N)", "gb18030"),
        ("時間(s),変位(mm),荷重(N)", "cp932"),
        ("시간(s),변위(mm),하중(N)", "cp949"),
        ("Czas (s),Wydłużenie (mm),Siła (N)", "cp1250"),
        ("Время (s),Перемещение (mm),Сила (N)", "cp1251"),
        ("Prüfzeit (s),Weg (mm),Kraft (N)", "cp1252"),
    ],
)
def test_known_word_identifies_the_encoding(tmp_path, head, encoding):
    imported = import_file(write(tmp_path, [head], ROWS[:50], encoding))
    assert f"text in {encoding}" in imported.read
    assert list(imported.roles) == head.split(",")


@pytest.mark.parametrize("names", ["时间,位移,力", "time_r,elongation_r,load_r"])
def test_advice_completes_known_words(tmp_path, names):
    path = write(tmp_path, [names])
    with pytest.raises(InputError, match="--unit displacement=mm --unit force=N"):
        import_file(path)
    check_press(by_the_advice(path))


@pytest.mark.parametrize("column", ["specimen", "Motor"])
def test_several_specimens_or_motors_in_a_file_are_noted(tmp_path, column):
    rows = [f"S{number},{row}" for number in (1, 2, 3) for row in ROWS]
    path = write(tmp_path, [f"{column},Time (s),Travel (mm),Load (N)"], rows)
    (note,) = [note for note in import_file(path).notes if "3 objects" in note]
    assert f"'{column}' names 3 objects" in note
    assert f"--where {column}=S1" in note


def test_rows_that_end_early_are_left_out_without_a_time(tmp_path):
    rows = [f"{place},{row.split(',', 1)[1]}" for place, row in enumerate(ROWS)]
    rows += [f"{place},," for place in range(len(ROWS), len(ROWS) + 200)]
    imported = import_file(write(tmp_path, ["counts,Travel (mm),Load (N)"], rows))
    check_press(imported)
    assert any("200 of 800 rows left out" in note for note in imported.notes)


def test_workbook_without_names_is_read_by_the_numbers_of_its_columns(tmp_path):
    path = tmp_path / "numbers.xlsx"
    book = openpyxl.Workbook()
    for row in ROWS:
        book.active.append([float(cell) for cell in row.split(",")])
    book.save(path)
    with pytest.raises(InputError, match="the file has no column names; its first row is"):
        import_file(path)
    check_press(import_file(path, BY_NUMBER))


def test_long_cell_is_skipped_and_a_long_first_line_is_refused(tmp_path):
    """Labels are looked for within a few words, not from each letter to the end of the text."""
    noted = [f"{row},{'A' * 800_000 if place == 3 else ''}" for place, row in enumerate(ROWS)]
    check_press(import_file(write(tmp_path, ["Time (s),Travel (mm),Load (N),note"], noted)))
