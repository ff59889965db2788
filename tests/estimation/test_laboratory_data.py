"""Import of laboratory files: notes, runs, phases, and questions in one line."""

import re

import numpy as np
import openpyxl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.control.loop.task import Phase
from palpate.estimation.data import file_columns
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_files import data_files, import_files
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.presses import cut_presses
from palpate.estimation.data.table import read_table
from palpate.estimation.data.text_table import as_utf8
from palpate.estimation.study.source import open_source
from palpate.robot_io.errors import InputError
from tests.estimation.laboratories import (
    SPEEDS_M_S,
    by_the_clock,
    excel,
    labview,
    one_file_a_run,
    presses,
    side_by_side,
    zwick,
)
from tests.estimation.press_tables import refusal
from tests.files import saved, write_csv

TIME, WAY, LOAD = "Time [s]", "Travel [mm]", "Load [N]"


@pytest.fixture
def press(tmp_path):
    """Writes presses with changed or added columns of numbers or text; None removes one."""
    t, x, f = presses()
    return lambda **changed: write_csv(tmp_path / "press.csv", {TIME: t, WAY: 1e3 * x, LOAD: f} | changed)


def some(values, every, start=0):
    """A column with a value in every so many rows, and empty cells between."""
    return ["" if (row - start) % every else value for row, value in enumerate(values.tolist())]


def contact_of(path, **options):
    (channel,) = import_file(path, ImportOptions(**options)).channels
    return channel


PROBES, FOAMS = (tuple(f"{name} {n}" for n in of) for name, of in (("Probe", "1234"), ("Foam", "ABCD")))


@pytest.mark.parametrize(
    ("write", "labels", "words"),
    [
        (
            zwick,
            (),
            "displacement 'Standardweg [mm]'; semicolons; decimal commas; 3 lines above the header; cp1252",
        ),
        (labview, (), "displacement 'Stroke [Millimeters]'; decimal commas"),
        (by_the_clock, (), "clock times converted to seconds"),
        (excel, PROBES, "sheets 'Probe 1', 'Probe 2', 'Probe 3', 'Probe 4' of 5"),
        (side_by_side, FOAMS, "4 tests side by side"),
    ],
)
def test_presses_are_read_from_files_of_machines(tmp_path, write, labels, words):
    imported = import_file(write(tmp_path))
    (channel,) = imported.channels
    assert tuple(imported.run_labels.values()) == (labels or ("0", "1", "2", "3"))
    parts = [presses((speed,)) for speed in SPEEDS_M_S] if labels else [presses()]
    np.testing.assert_allclose(channel.position, np.concatenate([x for _, x, _ in parts]), atol=1e-8)
    np.testing.assert_allclose(channel.effort, np.concatenate([f for _, _, f in parts]), atol=1e-4)
    assert all(word in imported.read for word in words.split("; ")), imported.read


def test_presses_of_one_file_are_runs_with_phases(press):
    imported = import_file(press())
    (channel,) = imported.channels
    assert "cut into 4 runs, one for each press" in imported.notes[0]
    assert len(channel.runs) == 4
    for run in channel.runs:
        one = channel.of_runs([run])
        assert one.position[0] < 0.0 > one.position[-1]
        order = [Phase(number) for number in dict.fromkeys(one.phase.tolist())]
        before, after = [Phase.FREE_AIR, Phase.APPROACH], [Phase.UNLOADING, Phase.RETRACT]
        assert order == [*before, Phase.LOADING, Phase.HOLD, *after]
        held = one.phase == Phase.HOLD
        assert one.position[held].min() > 0.0039
        assert np.ptp(one.time_s[held]) == pytest.approx(0.4, abs=0.1)


@pytest.mark.parametrize("count", [1, 3])
def test_number_of_runs_is_the_requested_one(press, count):
    assert len(contact_of(press(), runs=count).runs) == count


def test_small_presses_are_detected_beside_large_ones(press):
    t, x, f = presses()
    small = np.arange(len(t)) > 0.6 * len(t)
    channel = contact_of(
        press(**{WAY: np.where(small & (x > 0.0), 0.2, 1.0) * 1e3 * x, LOAD: f * (1 - 0.8 * small)})
    )
    assert len(channel.runs) == 4


@pytest.mark.parametrize("noise_mm", [0.0, 0.02])
def test_hold_between_sharp_ramps_keeps_its_length(press, noise_mm):
    parts = (np.full(30, -1.0), np.linspace(-1, 5, 60), np.full(200, 5.0), np.linspace(5, -1, 60))
    way_mm = np.concatenate([*parts, parts[0]])
    load = 0.5 * np.maximum(way_mm, 0.0)
    way_mm = way_mm + np.random.default_rng(0).normal(0.0, noise_mm, len(way_mm))
    time_s = np.round(0.01 * np.arange(len(way_mm)), 2)
    phase = contact_of(press(**{TIME: time_s, WAY: way_mm, LOAD: load})).phase
    assert np.sum(phase == Phase.HOLD) * 0.01 == pytest.approx(2.0, abs=0.05)
    assert np.sum(phase == Phase.APPROACH) * 0.01 == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("wavers", [0.0, 0.1])
def test_noise_is_no_press(press, wavers):
    t, x, f = (column[: len(column) // 4] for column in presses())
    one = press(**{TIME: t, WAY: 1e3 * x, LOAD: f + wavers * np.sin(20.0 * t)})
    assert len(contact_of(one, runs=1).runs) == 1
    with pytest.raises(InputError, match="--runs 3: at most 1 press can be separated"):
        contact_of(one, runs=3)


def test_force_below_every_level_is_one_run(press):
    load = np.where(np.arange(len(presses()[0])) % 50, 0.0, -1.0)
    assert len(contact_of(press(**{LOAD: load})).runs) == 1


def test_many_presses_are_grouped_into_runs(press):
    t = np.arange(30_000) * 0.02
    x = 4.0 * np.sin(5.0 * np.pi * t)  # 1500 presses
    imported = import_file(press(**{TIME: t, WAY: x, LOAD: 0.8 * np.maximum(x, 0.0)}))
    (channel,) = imported.channels
    assert "cut into 500 runs, one for every 3 presses" in imported.notes[0]
    ends = np.flatnonzero(np.diff(channel.run))
    assert np.all(channel.position[ends] < 0.0)
    assert np.ptp(np.diff(ends)) <= 2


@pytest.mark.parametrize(("count", "each"), [(499, 1), (500, 1), (501, 2)])
def test_number_of_presses_is_limited_by_the_number_of_runs(count, each):
    wave = np.sin(2.0 * np.pi * np.arange(60 * count) / 60)
    run, presses = cut_presses(
        np.maximum(wave, 0.0), wave, np.zeros(len(wave), dtype=int), np.arange(wave.size)
    )
    assert (run[-1] + 1, presses) == (-(-count // each), each)


@pytest.mark.parametrize(
    ("changed", "note"),
    [
        ({LOAD: -presses()[2], WAY: -1e3 * presses()[1]}, "are negative in compression, so their signs are"),
        ({WAY: None, "Position [mm]": 1e3 * presses()[1]}, "change together, as in a press; if 'Pos"),
        *(
            ({TIME: scale * presses()[0]}, f"samples are {step} s apart; .* --unit time={unit}$")
            for scale, step, unit in ((1e3, "4", "ms"), (1e6, r"4e.03", "us"), (1e9, r"4e.06", "ns"))
        ),
        (
            {WAY: some(1e3 * presses()[1], 4)},
            "'Travel .mm.' has a value in 25 % of the rows, so only complete",
        ),
        (
            {WAY: some(1e3 * presses()[1], 2), LOAD: some(presses()[2], 2, 1)},
            "all other columns are interpolated at the times of 'Load",
        ),
        ({"Cycle": np.repeat([1, 2], len(presses()[0]) // 2)}, ""),
    ],
)
def test_unusual_data_are_reported_and_read(press, changed, note):
    imported = import_file(press(**changed))
    (channel,) = imported.channels
    assert channel.name == "contact"
    pressed = channel.position > 1e-3
    assert channel.effort[pressed].mean() / channel.position[pressed].mean() == pytest.approx(800.0, rel=0.02)
    if note:
        assert any(re.search(note, said) for said in imported.notes), imported.notes
    else:
        assert len(channel.runs) == 2


T = presses()[0]
RATE = {WAY: None, LOAD: None, "Angle [deg]": np.sin(T)}


@pytest.mark.parametrize(
    ("changed", "options", "words"),
    [
        ({"Force": T, "Force [N]": T}, {}, "columns 'Load [N]' and 'Force [N]' may hold force"),
        ({LOAD: None, "A [N]": T, "B [N]": -T}, {}, "may hold force; choose with --column force='A [N]'"),
        ({TIME: T[::-1]}, {}, "column 'Time [s]' decreases throughout; reverse the order of the rows"),
        (
            {WAY: None, "Travel": 1e3 * presses()[1]},
            {},
            "'Travel' states no unit; give it, as in --unit displacement=mm",
        ),
        (
            {LOAD: None, "Load [furlong]": T},
            {},
            "states no unit ('furlong' is not a known unit); give it, as in --unit force=10N, with the size",
        ),
        ({TIME: None, "Time (ticks)": T}, {}, "'ticks' is not a known unit of time; give it as a multiple"),
        ({LOAD: None, "Load setpoint [N]": T}, {}, "no channel can be made of"),
        ({LOAD: None, "Oven [degC]": T}, {}, "no channel can be made of"),
        ({"run": np.zeros(len(T), int)}, {"runs": 2}, "--runs 2: the file already gives the runs ('run': 0)"),
        ({"Current [mA]": T} | RATE, {"runs": 2}, "--runs 2: there is no contact"),
        ({}, {"units": {"force": "3 parsec"}}, "is not a unit of force"),
    ],
)
def test_undetermined_columns_are_asked_for_in_one_line(press, changed, options, words):
    assert words in refusal(press(**changed), **options)


@pytest.mark.parametrize(
    ("units", "factor"),
    [({}, 1.0), ({"torque": "0.5Nm/A"}, 0.5), ({"torque": "-2 Nm/A"}, -2.0), ({"Current [mA]": "A"}, 1000.0)],
)
def test_current_is_used_as_torque_without_a_constant(press, units, factor):
    current = np.cos(3.0 * T)
    imported = import_file(press(**RATE, **{"Current [mA]": 1e3 * current}), ImportOptions(units=units))
    (channel,) = imported.channels
    np.testing.assert_allclose(channel.effort, factor * current)
    np.testing.assert_allclose(channel.position, np.radians(np.sin(T)))
    unknown = "torque" not in units
    assert any("results are in A, not N m" in note for note in imported.notes) is unknown
    assert channel.effort_unit == ("A" if unknown else "N m")


def test_torque_is_preferred_to_current_and_no_column_is_used_twice(press):
    columns = {"Current [mA]": T, "Torque [Nm]": 2.0 * T, "Torque setpoint [Nm]": T}
    (channel,) = import_file(press(**RATE, **columns)).channels
    np.testing.assert_allclose(channel.effort, 2.0 * T)


def test_columns_without_units_are_asked_about_only_without_another_channel(press):
    joint = {"q": np.sin(T), "tau": T}
    assert contact_of(press(**joint)).name == "contact"
    with pytest.raises(InputError, match="'q', 'tau' state no units"):
        import_file(press(**joint, **{WAY: None}))
    said = ImportOptions(units={"position": "rad", "torque": "Nm"})
    assert [one.name for one in import_file(press(**joint), said).channels] == ["contact", "joint_1"]


@pytest.mark.parametrize("said", ["depth", "Travel"])
def test_unit_counts_under_every_name_of_its_quantity(press, said):
    """Columns without a unit are left alone where others make a channel, unless the user says it."""
    joint = {"position_1_rad": np.sin(T), "torque_1_Nm": np.cos(T)}
    imported = import_file(
        press(**joint, **{WAY: None, "Travel": 1e3 * presses()[1]}), ImportOptions(units={said: "mm"})
    )
    assert [channel.name for channel in imported.channels] == ["contact", "joint_1"]


def test_files_of_a_folder_are_runs_in_numerical_order(tmp_path):
    folder = one_file_a_run(tmp_path)
    assert [path.name for path in data_files(folder)] == ["run9.csv", "run10.csv", "run11.csv", "run12.csv"]
    imported = import_files(data_files(folder), ImportOptions())
    assert list(imported.run_labels.values()) == ["run9.csv", "run10.csv", "run11.csv", "run12.csv"]
    for data in (folder, data_files(folder), [str(path) for path in data_files(folder)]):
        (channel,) = open_source(data).channels
        np.testing.assert_array_equal(channel.run, imported.channels[0].run)
    same = folder / ".." / folder.name / "run9.csv"
    with pytest.raises(InputError, match=r"run9\.csv: is given twice"):
        import_files([*data_files(folder), same], ImportOptions())
    (folder / "second.csv").write_text(
        "time_s,position_rad,torque_Nm\n" + "".join(f"{i},1,{i}\n" for i in range(9))
    )
    with pytest.raises(InputError, match=r"second\.csv: has no channel 'contact'"):
        open_source(folder)


def test_sheets_with_reordered_columns_are_runs_and_others_are_named(tmp_path):
    book = openpyxl.Workbook()
    for sheet, names in (
        (book.active, "sxF"),
        (book.create_sheet("B"), "Fsx"),
        (book.create_sheet("C"), "sx"),
    ):
        sheet.append([{"s": "Time (s)", "x": "Way (mm)", "F": "Load (N)"}[name] for name in names])
        for row in range(30):
            sheet.append([{"s": row, "x": 2 * row, "F": 3 * row}[name] for name in names])
    for row in ((), ("Day", "Rain (mm)"), *((day, 3 * day) for day in range(5))):
        book["C"].append(row)
    book.save(tmp_path / "order.xlsx")
    table = read_table(tmp_path / "order.xlsx")
    np.testing.assert_array_equal(table.numbers("Load (N)"), 3.0 * table.numbers("Time (s)"))
    assert len(table) == 60
    omitted = "not read, because the columns differ: 'C:1' (30 rows), 'C:33' (5 rows)"
    assert f"{omitted}; --table C:1 reads one" in table.notes
    selected = [read_table(tmp_path / "order.xlsx", title).names for title in ("C:33", "C")]
    assert selected == [("Day", "Rain (mm)"), ("Time (s)", "Way (mm)")]


@pytest.mark.parametrize("other", ["Cycle time [s]", "Clock"])
def test_monotonic_time_column_is_preferred(press, other):
    t = presses()[0]
    cells = {"Clock": [f"9:{each // 60:02.0f}:{each % 60:06.3f}" for each in t], "Cycle time [s]": t % 2.0}
    np.testing.assert_allclose(
        np.diff(contact_of(press(**{other: cells[other]})).time_s), np.diff(t), atol=1e-9
    )


def test_time_with_a_bad_cell_is_skipped_beside_another(press):
    stamps = (1e3 * presses()[0]).astype(str).tolist()
    path = press(Timestamp=[*stamps[:300], "ERR", *stamps[301:]])
    np.testing.assert_allclose(contact_of(path).time_s, presses()[0])
    with pytest.raises(InputError, match="line 302, column 'Timestamp': 'ERR' is no"):
        contact_of(path, columns={"time": "Timestamp"})


def test_workbook_that_would_fill_the_memory_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "far.xlsx"
    book = openpyxl.Workbook()
    book.active["A1"], book.active["XFD1048576"] = 1, 2
    book.save(path)
    with pytest.raises(InputError, match="1048576 rows and 16384 columns, too many to read; split it"):
        read_table(path)
    monkeypatch.setattr(file_columns, "MAX_BYTES", 100)
    with pytest.raises(InputError, match="holds more than the limit of 0 MiB; split it"):
        read_table(path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_text_is_the_same_in_every_encoding(tmp_path, encoding):
    text = "Zeit [s];Weg [µm];Prüfkraft [N]\r\n1,5;2;3\r\n"
    assert as_utf8(text.encode(encoding), tmp_path)[0].decode() == text


GOOD = "Time [s],Way [mm],Load [N]\n" + "".join(f"{i},{i},{i}\n" for i in range(9))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0", "is a picture"),
        (b"\xff\xd8\xff\xe0\0\x10JFIF", "is a picture"),
        (b"%PDF-1.7\n\0\xff\x81", "is a PDF"),
        (b"PK\x03\x04\x14\0\0", "end in .xlsx"),
        (b"\x1f\x8b\x08\0\x81", "end in .gz"),
        (b"PAR1\x15\0\x81", "end in .parquet"),
        (b"\0\x81\x82", "is not a text file; save it as CSV"),
        # A row that is cut off is no footer.
        (
            f"{GOOD}\nSpecimen 2\n{GOOD}9,9\n".encode(),
            r"csv, test 2: line 23 has 2 cells, but the header has 3",
        ),
        (f"{GOOD}9\n".encode(), "line 11 has 1 cell, but the header has 3"),
    ],
)
def test_file_without_a_table_is_named(tmp_path, content, words):
    with pytest.raises(InputError, match=words):
        import_file(saved(tmp_path / "a.csv", content))


@given(st.binary(max_size=300))
def test_random_bytes_get_one_line(tmp_path_factory, content):
    assert refusal(saved(tmp_path_factory.mktemp("any") / "any.lvm", content))


@pytest.mark.parametrize(
    ("cells", "delimiter", "values"),
    [
        (("1,5", "2,25", "-0,125"), ";", (1.5, 2.25, -0.125)),
        (("1.234,5", "999,5", "12.345.678,25"), ";", (1234.5, 999.5, 12345678.25)),
        (("1,234.5", "999.5", "12,345,678.25"), "\t", (1234.5, 999.5, 12345678.25)),
        (('"1,234.5"', "999.5", "0.25"), ",", (1234.5, 999.5, 0.25)),
        (("1,234", "2,345", "3,456"), ";", (1.234, 2.345, 3.456)),
        (("1.234", "2.345", "3.456"), ";", (1.234, 2.345, 3.456)),
        (("1,5E-3", "2E+2", " 7 "), "\t", (1.5e-3, 200.0, 7.0)),
        ((".5", "-.25", "3."), "|", (0.5, -0.25, 3.0)),
    ],
)
def test_numbers_are_read_as_written(tmp_path, cells, delimiter, values):
    path = tmp_path / "numbers.txt"
    lines = ["n [s]" + delimiter + "Kraft [N]", *(f"{i}{delimiter}{cell}" for i, cell in enumerate(cells))]
    path.write_text("\n".join(lines))
    assert read_table(path).numbers("Kraft [N]").tolist() == list(values)


def test_misplaced_thousands_comma_is_refused(tmp_path):
    path = saved(tmp_path / "numbers.txt", "n [s]\tKraft [N]\n0\t1,234.5\n1\t2,345.5\n2\t3,456.5\n3\t4,5\n")
    with pytest.raises(InputError, match=r"line 5, column .*'4,5' is not a finite number"):
        read_table(path).numbers("Kraft [N]")


@pytest.mark.parametrize(
    ("cells", "seconds"),
    [
        (("0:00.25", "0:59,75", "1:00.5"), (0.25, 59.75, 60.5)),
        (("23:59:59.5", "00:00:00.5", "00:00:01.0"), (86399.5, 86400.5, 86401.0)),
        (("2024-02-29T23:59:59.5Z", "2024-03-01T00:00:00.5Z", ""), (86399.5, 86400.5, None)),
        (("31.12.2023 23:59:59", "01.01.2024 00:00:00", "01.01.2024 00:00:01"), (86399.0, 86400.0, 86401.0)),
        (
            ("3/17/2024 11:59:59.5 AM", "3/17/2024 12:00:00.5 PM", "3/18/2024 1:00:00 AM"),
            (43199.5, 43200.5, 90000.0),
        ),
        (("100:00:00.0", "100:00:00.5", "0:00:01"), (360000.0, 360000.5, 1.0)),
        (("1:00:00\u202fAM", "1:00:01\u202fAM", "1:00:00\u00a0PM"), (3600.0, 3601.0, 46800.0)),
        (("08:00:00.0", "08:00:01.0", "21:00:00.0"), (28800.0, 28801.0, 75600.0)),
        (("1:00:01:995000", "1:00:02:4048", "1:00:02:14173"), (3601.995, 3602.004048, 3602.014173)),
        (("1:00:01:95", "1:00:02:05", "1:00:03:10"), (3601.95, 3602.05, 3603.1)),
    ],
)
def test_clock_times_are_seconds(tmp_path, cells, seconds):
    path = tmp_path / "clock.csv"
    path.write_text("When;Weg [mm];Kraft [N]\n" + "".join(f"{cell};1;2\n" for cell in cells))
    table = read_table(path)
    assert table.columns.column("When").to_pylist() == list(seconds)
    assert any(word.startswith("clock times converted to seconds: 'When'") for word in table.notes)


@pytest.mark.parametrize(
    ("dates", "days", "order"),
    [
        (("01/03/2024", "01/03/2024", "02/03/2024"), (0, 0, 1), "day/month"),
        (("3/1/2024", "3/1/2024", "3/2/2024"), (0, 0, 1), "month/day"),
        (("12/03/2024", "13/03/2024", "14/03/2024"), (0, 1, 2), "day/month"),
        (("03/12/2024", "03/13/2024", "03/14/2024"), (0, 1, 2), "month/day"),
    ],
)
def test_month_and_day_have_one_order_in_all_dates(tmp_path, dates, days, order):
    path = tmp_path / "dates.csv"
    path.write_text("When,Weg [mm],Kraft [N]\n" + "".join(f"{day} 10:00:00.0,1,2\n" for day in dates))
    table = read_table(path)
    np.testing.assert_allclose(np.diff(table.numbers("When")), 86400.0 * np.diff(days))
    assert f"clock times converted to seconds: 'When' as {order}" in table.notes


@pytest.mark.parametrize("name", ["Stamp", "Time [min]", "time_ms"])
def test_clock_column_counts_seconds_for_any_unit_in_its_name(press, name):
    cells = [f"{int(cell // 60.0):02d}:{cell % 60.0:07.4f}" for cell in presses()[0]]
    path = press(**{TIME: None, name: cells})
    for columns in ({}, {"time": name}):
        channel = contact_of(path, columns=columns)
        assert np.ptp(channel.time_s) == pytest.approx(np.ptp(presses()[0]), abs=1e-3)


def test_clock_beside_the_time_and_invalid_dates_leave_columns_unchanged(press):
    cells = [f"09:{int(cell // 60.0):02d}:{cell % 60.0:07.4f}" for cell in presses()[0]]
    assert np.ptp(contact_of(press(Time=cells)).time_s) == pytest.approx(np.ptp(presses()[0]), abs=1e-3)
    assert contact_of(press(Made=["0000-00-00 00:00:00"] * len(presses()[0]))).name == "contact"
    times = [f"0:{cell:07.4f}" for cell in presses()[0] % 60.0]
    with pytest.raises(InputError, match=r"line 9, column 'Time .s.': '0:xx' is not a finite number; remove"):
        contact_of(press(**{TIME: [*times[:7], "0:xx", *times[8:]]}))


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_time_unit_is_inferred_from_the_sample_step(press, scale, unit):
    imported = import_file(press(**{TIME: None, "__time": 1.7e9 * (scale == 1.0) + scale * presses()[0]}))
    assert np.ptp(imported.channels[0].time_s) == pytest.approx(np.ptp(presses()[0]), rel=1e-6)
    assert f"'__time' states no unit and is read in {unit}, as its sample step suggests" in imported.notes[0]


SWING = {"time_s": np.arange(400) * 0.01, "position_1_rad": np.sin(0.02 * np.arange(400))}
PULL = {"time_s": SWING["time_s"], "torque_1_Nm": 2.0 * SWING["position_1_rad"]}


def test_position_and_torque_files_of_equal_rows_are_one_recording(tmp_path):
    paths = [write_csv(tmp_path / "q.csv", SWING), write_csv(tmp_path / "tau.csv", PULL)]
    imported = import_files(paths, ImportOptions())
    (joint,) = imported.channels
    assert "2 files with the same rows are joined side by side: q.csv, tau.csv" in imported.read
    np.testing.assert_allclose(joint.effort, 2.0 * joint.position)
    assert joint.run.max() == 0


def test_columns_without_names_are_called_after_their_file(tmp_path):
    angles = np.sin(0.02 * np.arange(400)[:, None] + [0.0, 1.0])
    paths = [tmp_path / "q.csv", tmp_path / "tau.csv"]
    for path, values in zip(paths, (angles, 3.0 * angles), strict=True):
        np.savetxt(path, values, delimiter=",")
    imported = import_files(paths, ImportOptions(units={"position": "rad", "torque": "Nm"}))
    assert [channel.name for channel in imported.channels] == ["joint_1", "joint_2"]
    for channel in imported.channels:
        np.testing.assert_allclose(channel.effort, 3.0 * channel.position)


def test_numbered_logs_without_names_are_runs_of_equal_columns(tmp_path):
    paths = [tmp_path / "log1.txt", tmp_path / "log2.txt"]
    for number, path in enumerate(paths):
        np.savetxt(path, np.random.default_rng(number).normal(size=(400, 3)))
    with pytest.raises(InputError, match=r"log1\.txt: no channel can be made of columns column 1, column 2"):
        import_files(paths, ImportOptions())


@pytest.mark.parametrize(
    "further",
    [
        {name: values[:300] for name, values in PULL.items()},  # other rows
        {**PULL, "time_s": PULL["time_s"] + 1.0},  # the same column with other values
        {"nothing but words": []},
    ],
)
def test_files_that_do_not_belong_side_by_side_are_not_joined(tmp_path, further):
    paths = [write_csv(tmp_path / "q.csv", SWING), write_csv(tmp_path / "tau.csv", further)]
    with pytest.raises(InputError, match=r"q\.csv"):
        import_files(paths, ImportOptions())


def test_joint_missing_in_the_first_file_is_left_out_and_in_another_refused(tmp_path):
    one = SWING | PULL
    second = {name.replace("_1_", "_2_"): values for name, values in one.items() if name != "time_s"}
    paths = [write_csv(tmp_path / "one.csv", one), write_csv(tmp_path / "two.csv", one | second)]
    imported = import_files(paths, ImportOptions())
    (joint,) = imported.channels
    assert joint.context["joint_position"].shape == (len(joint), 1)
    assert "two.csv: joint_2 left out, because one.csv has no such channel" in imported.notes
    with pytest.raises(InputError, match=r"one\.csv: has no channel 'joint_2', which .*two\.csv has"):
        import_files(paths[::-1], ImportOptions())
