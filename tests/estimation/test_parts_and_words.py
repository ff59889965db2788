"""Files that hold a part of a measurement, and names in which a word tells the quantity."""

import gzip
import zipfile

import numpy as np
import pytest
from scipy.io import savemat

from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.column_names import guess_columns
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_files import import_files
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import read_table
from palpate.robot_io.errors import InputError
from palpate.robot_io.files import atomic_write
from tests.estimation.press_tables import FORCE_N, HEADER, TIME_S, WAY_M, lines, refusal
from tests.files import saved


def test_files_with_one_column_each_are_joined(tmp_path):
    way = saved(tmp_path / "deformation_data.txt", lines(1e3 * WAY_M))
    force = saved(tmp_path / "force_data.txt", lines(FORCE_N))
    assert "holds only one column" in refusal(way)
    units = {"displacement": "mm", "force": "N"}
    (channel,) = import_files([way, force], ImportOptions(units=units)).channels
    assert channel.kind is ChannelKind.CONTACT
    assert np.allclose(channel.effort, FORCE_N, atol=1e-6)


@pytest.mark.parametrize(
    ("names", "quantities"),
    [
        (["timeJIM", "angleJIM", "torque"], ["time", "position", "torque"]),
        (["t", "torAct", "posAct"], ["time", "torque", "position"]),
        (["time", "motorStatePos_0", "motorStateCur_0"], ["time", "position", "torque"]),
        (["time values", "angle values", "torque values"], ["time", "position", "torque"]),
        (["Neo_Avg_Strain_L", "Neo_Avg_Stress_L"], ["displacement", "force"]),
        (["PositionArrayb", "ForceArrayb"], ["position", "force"]),
        (["theta 1", "theta 2", "tau_raw 1", "tau_raw 2"], ["position", "position", "torque", "torque"]),
        (["Trial_Elapsed_s", "Middle_Angle", "Middle_Force_N"], ["time", "position", "force"]),
        (["Time", "PosFb", "SpeedFb", "CurrentMeas"], ["time", "position", "velocity", "torque"]),
        (["t", "theta_m", "tau_m"], ["time", "position", "torque"]),  # of a motor, not in meters
        (["t", "theta_in", "tau_in"], ["time", "position", "torque"]),
        (["t", "q 1", "i 1"], ["time", "position", "torque"]),
        (["t", "hip_q", "hip_i", "knee_q", "knee_i"], ["time", *("position", "torque") * 2]),
        (["t", "depth_mm", "P_g", "P_G"], ["time", "displacement", "", ""]),  # a gauge pressure
        (["t", "angle_deg", "Pressure_A", "P_A", "F_A"], ["time", "position", "", "", ""]),  # of a chamber
        (["t", "theta_n", "v_a", "i_a"], ["time", "position", "", "torque"]),  # of an armature
        (["t", "depth_mm", "Acceleration (g)"], ["time", "displacement", ""]),
        (["T (°C)", "depth_mm", "load_N"], ["", "displacement", "force"]),
    ],
)
def test_a_word_anywhere_tells_the_quantity_if_no_channel_is_found_otherwise(names, quantities):
    assert [guess.quantity for guess in guess_columns(names)] == quantities


def test_words_anywhere_do_not_add_columns_to_a_clear_measurement():
    names = ["time_s", "displacement_mm", "force_N", "torqueSensorRaw", "angleOfTable", "Valve travel"]
    assert [guess.quantity for guess in guess_columns(names)][3:] == ["", "", ""]


def test_a_current_is_not_preferred_to_a_torque_without_units(tmp_path):
    q, tau = np.sin(TIME_S), np.cos(TIME_S)
    both = saved(tmp_path / "both.csv", "time,position,torque,current\n" + lines(TIME_S, q, tau, 3.0 * tau))
    assert "columns 'position', 'torque' state no units" in refusal(both)
    current = saved(tmp_path / "current.csv", "time,position,current\n" + lines(TIME_S, q, 3.0 * tau))
    assert "--unit position=rad --unit torque=A" in refusal(current)


@pytest.mark.parametrize(
    ("names", "sizes", "said"),
    [
        ("position,load", (1.0, 1.0), "--column torque=load --unit position=rad --unit torque=Nm"),
        ("q1,q2,tau1,tau2", (1.0, 90.0, 1.0, 1.0), "--unit position=deg --unit torque=Nm"),  # one for both
        ("shoulderPosRaw,elbowTorqueRaw", (1.0, 1.0), "no channel can be made"),  # of different joints
        ("q1,q2,q3,q4,q5,tau1,tau2,tau3,tau4,tau5", np.ones(10), "'tau2', 'tau3' ... state no units"),
        (
            "pos (1),pos (2),current (1),current (2)",
            np.ones(4),
            "'current (1)', 'current (2)' state no units",
        ),
        ("angle,volume", (90.0, 1.0), "--unit position=deg --column torque_Nm=COLUMN"),
        (
            "strain,volume",
            (90.0, 1.0),
            "--column displacement=strain --unit displacement=% --column force_N=",
        ),
        ("strain,volume", (1.0, 1.0), "--unit displacement=strain --column force_N="),
        ("angle,goal angle", (90.0, 1.0), "--unit position=deg --unit goal=deg"),  # of one servo
        ("position_mm,torque [Nm],load1_N,load2_N", np.arange(4), "'load1_N' and 'load2_N' may hold force"),
        (
            "current_pos_x,force_x,force_y,joint_1,joint_2",
            np.arange(5),
            "'force_x' and 'force_y' may hold force",
        ),
        (
            "Voltage [V],Test 1 [g],Test 2 [g]",
            (1.0, 2.0, 3.0),
            "displacement=COLUMN --column force='Test 1",
        ),
    ],
)
def test_columns_without_units_may_be_joints(tmp_path, names, sizes, said):
    table = f"time,{names}\n" + lines(TIME_S, *(size * np.sin(TIME_S) for size in sizes))
    assert said in refusal(saved(tmp_path / "joints.csv", table))


def test_structs_in_cells_are_runs(tmp_path):
    cells = np.empty((1, 3), dtype=object)
    for number in range(3):
        time = np.arange(200 + number) / 100.0
        cells[0, number] = {"t": time, "q": np.sin(time), "tau": np.cos(time) + number}
    savemat(tmp_path / "runs.mat", {"train": cells, "rate": 100.0})
    units = {"position": "rad", "torque": "Nm"}
    imported = import_file(tmp_path / "runs.mat", ImportOptions(units=units))
    (channel,) = imported.channels
    assert [int(np.sum(channel.run == run)) for run in channel.runs] == [200, 201, 202]
    assert "3 groups with the same columns, read as runs" in imported.read
    assert imported.run_labels[2] == "train 3"


def test_structs_without_a_clock_are_no_runs(tmp_path):
    force, way = {"a": FORCE_N, "b": FORCE_N, "c": FORCE_N}, {"a": WAY_M, "b": WAY_M, "c": WAY_M}
    savemat(tmp_path / "vectors.mat", {"force": force, "way": way, "other": WAY_M[:5]})
    table = read_table(tmp_path / "vectors.mat")
    assert "run" not in table.names
    assert table.notes == ("columns of other lengths left out: other",)
    assert refusal(tmp_path / "vectors.mat").endswith(table.notes)


@pytest.mark.parametrize("outer", ["t", "log.t", ""])
def test_structs_of_joints_are_no_runs(tmp_path, outer):
    """One clock beside them was lost, and joints became runs."""
    names = ["joint1", "joint2"] if not outer else ["part1", "part2"]
    parts = {name: {"q": WAY_M + n, "dq": WAY_M, "tau": FORCE_N} for n, name in enumerate(names)}
    inside = parts | ({"t": TIME_S} if outer else {})
    savemat(tmp_path / "arm.mat", {"log": inside} if "." in outer else inside)
    table = read_table(tmp_path / "arm.mat")
    assert "run" not in table.names
    assert ("t" in table.names) == bool(outer)
    for n, name in enumerate(names):
        np.testing.assert_allclose(table.numbers(f"{name}.q"), WAY_M + n)


def test_time_of_only_some_files_is_not_that_of_all(tmp_path):
    files = [
        saved(tmp_path / "a.csv", HEADER + lines(TIME_S, 1e3 * WAY_M, FORCE_N)),
        saved(tmp_path / "b.csv", "Travel [mm],Load [N]\n" + lines(1e3 * WAY_M, FORCE_N)),
    ]
    for both in (files, files[::-1]):
        (channel,) = import_files(both, ImportOptions()).channels
        assert not channel.has_time


def archive(path, files):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as zipped:
        for name, text in files.items():
            zipped.writestr(name, text)
    return path


def test_the_tables_of_an_archive_are_runs(tmp_path):
    text = HEADER + lines(TIME_S, 1e3 * WAY_M, FORCE_N)
    files = {
        "a/press 10.csv": text,
        "a/press 2.csv": text,
        "../notes.txt": "by hand\n",
        "__MACOSX/p.csv": "x",
    }
    imported = import_file(archive(tmp_path / "all.zip", files))
    (channel,) = imported.channels
    assert channel.kind is ChannelKind.CONTACT
    assert list(imported.run_labels.values()) == ["press 2.csv", "press 10.csv"]
    assert "2 files of the archive, read as runs" in imported.read
    assert sorted(path.name for path in tmp_path.iterdir()) == ["all.zip"]
    (one,) = import_file(tmp_path / "all.zip", ImportOptions(where={"run": "press 2.csv"})).channels
    assert len(one.time_s) == len(TIME_S)


def test_compressed_file_in_an_archive_is_read(tmp_path):
    text = HEADER + lines(TIME_S, 1e3 * WAY_M, FORCE_N)
    path = archive(tmp_path / "all.zip", {"press.CSV.gz": gzip.compress(text.encode())})
    np.testing.assert_allclose(import_file(path).channels[0].effort, FORCE_N, atol=1e-6)


def test_files_of_one_name_in_two_folders_of_an_archive_are_two_runs(tmp_path):
    text = HEADER + lines(TIME_S, 1e3 * WAY_M, FORCE_N)
    imported = import_file(archive(tmp_path / "all.zip", {"a/1.csv": text, "b/1.csv": text}))
    assert list(imported.run_labels.values()) == ["a/1.csv", "b/1.csv"]


def test_a_compression_bomb_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic_write, "_ALLOWED_BYTES", 100_000)
    path = archive(tmp_path / "bomb.zip", {"a.csv": "0" * 2**20})
    with pytest.raises(InputError, match="the limit"):
        read_table(path)


def test_an_archive_without_a_table_is_refused_with_the_fault(tmp_path):
    with pytest.raises(InputError, match=r"words\.txt"):
        read_table(archive(tmp_path / "words.zip", {"words.txt": "only words\nhere\n"}))
    with pytest.raises(InputError, match="holds no data file"):
        read_table(archive(tmp_path / "empty.zip", {"photo.jpg": "x"}))


_ODS_HEAD = (
    '<office:document-content xmlns:office="urn:oasis:names:tc:opendocument:xmlns:office:1.0" '
    'xmlns:table="urn:oasis:names:tc:opendocument:xmlns:table:1.0" '
    'xmlns:text="urn:oasis:names:tc:opendocument:xmlns:text:1.0"><office:body><office:spreadsheet>'
    '<table:table table:name="Press">'
)
_ODS_TAIL = "</table:table></office:spreadsheet></office:body></office:document-content>"


def sheet_file(path, rows):
    manifest = '<m:manifest xmlns:m="urn:oasis:names:tc:opendocument:xmlns:manifest:1.0"></m:manifest>'
    kind = "application/vnd.oasis.opendocument.spreadsheet"
    files = {"mimetype": kind, "META-INF/manifest.xml": manifest}
    return archive(path, files | {"content.xml": _ODS_HEAD + rows + _ODS_TAIL})


def sheet_row(*cells, of_row="", of_cell=""):
    written = ""
    for cell in cells:
        kind = "string" if isinstance(cell, str) else "float"
        value = "" if isinstance(cell, str) else f'office:value="{cell!r}"'
        text = f"<text:p>{cell}</text:p>"
        written += f'<table:table-cell {of_cell} office:value-type="{kind}" {value}>{text}</table:table-cell>'
    return f"<table:table-row {of_row}>{written}</table:table-row>"


def test_a_sheet_of_an_open_document_is_read(tmp_path):
    numbers = np.column_stack([TIME_S, 1e3 * WAY_M, FORCE_N]).tolist()
    rows = sheet_row(*HEADER.strip().split(",")) + "".join(sheet_row(*row) for row in numbers)
    empty = '<table:table-row table:number-rows-repeated="1048000"><table:table-cell/></table:table-row>'
    (channel,) = import_file(sheet_file(tmp_path / "press.ods", rows + empty)).channels
    assert np.allclose(channel.effort, FORCE_N)


def test_cells_of_an_open_document_that_repeat_beyond_the_limit_are_refused(tmp_path):
    repeated = {"of_row": 'table:number-rows-repeated="1000000"'}
    rows = sheet_row(1.0, of_cell='table:number-columns-repeated="10000"', **repeated)
    with pytest.raises(InputError, match="too many to read"):
        read_table(sheet_file(tmp_path / "bomb.ods", rows))


def test_signals_of_a_scope_have_the_names_of_their_labels(tmp_path):
    time = np.arange(300) / 100.0
    signals = np.empty(2, dtype=object)
    signals[0] = {"values": np.sin(time), "label": "position (rad)", "dimensions": 1.0}
    signals[1] = {"values": np.cos(time), "label": "torque (Nm)", "dimensions": 1.0}
    savemat(tmp_path / "scope.mat", {"scope": {"time": time, "signals": signals}, "J": 0.1})
    of_dspace = np.empty(2, dtype=object)
    of_dspace[0] = {"Name": '"Model Root"/"position"', "Data": np.sin(time), "Unit": "rad", "XIndex": 1}
    of_dspace[1] = {"Name": '"Model Root"/"torque"', "Data": np.cos(time), "Unit": "Nm", "XIndex": 1}
    savemat(tmp_path / "dspace.mat", {"test1": {"X": {"Data": time, "Type": 4}, "Y": of_dspace}})
    for path in tmp_path.iterdir():
        (channel,) = import_file(path).channels
        assert channel.kind is ChannelKind.REVOLUTE
        assert np.allclose(channel.effort, np.cos(time))


def test_a_strain_that_may_be_in_percent_is_asked_for(tmp_path):
    header = "time_s,Strain,Stress [MPa]\n"
    percent = saved(tmp_path / "percent.csv", header + lines(TIME_S, 3e3 * WAY_M, FORCE_N))
    assert refusal(percent).endswith("'Strain' states no unit; give it, as in --unit displacement=%")
    ratio = import_file(saved(tmp_path / "ratio.csv", header + lines(TIME_S, 30.0 * WAY_M, FORCE_N)))
    assert ratio.channels[0].kind is ChannelKind.CONTACT
    header = "time_s,Strain (-),Stress [MPa]\n"
    stated = import_file(saved(tmp_path / "stated.csv", header + lines(TIME_S, 3e3 * WAY_M, FORCE_N)))
    assert stated.channels[0].kind is ChannelKind.CONTACT


def test_nanoseconds_are_added_to_whole_seconds(tmp_path):
    since = 1.7e9 + np.round(TIME_S * 1e9) * 1e-9
    whole = np.floor(since)
    nanoseconds = np.round((since - whole) * 1e9)
    header = "stamp.sec,stamp.nanosec,displacement [mm],force [N]\n"
    path = saved(tmp_path / "ros.csv", header + lines(whole, nanoseconds, 1e3 * WAY_M, FORCE_N))
    (channel,) = import_file(path).channels
    assert np.allclose(np.diff(channel.time_s), np.diff(TIME_S), atol=1e-6)


def test_columns_without_names_are_proposed_by_their_shape(tmp_path):
    noisy = FORCE_N + 0.2 * np.random.default_rng(3).standard_normal(len(FORCE_N))
    message = refusal(saved(tmp_path / "three.csv", lines(noisy, TIME_S, WAY_M)))
    ending = "--column time='column 2' --column displacement='column 3' --column force='column 1'"
    assert message.endswith(ending)
    message = refusal(saved(tmp_path / "four.csv", lines(WAY_M, FORCE_N, FORCE_N, WAY_M)))
    several = "for several joints, as in --column position_1=COLUMN --column torque_1=COLUMN"
    interval = "if no column holds the time, add the interval of rows, such as --unit time=10ms"
    assert message.endswith(
        f"as in --column displacement=COLUMN --column force=COLUMN; {several}; {interval}"
    )
    assert interval not in refusal(tmp_path / "four.csv", columns={"time": "column 1"})


@pytest.mark.parametrize("last", ["constant", "one empty cell"])
def test_clock_of_columns_without_names_is_never_proposed_as_the_motion(tmp_path, last):
    cells = ["5"] * len(TIME_S) if last == "constant" else [*map(str, FORCE_N[:-1]), ""]
    rows = zip(TIME_S, WAY_M, cells, strict=True)
    path = saved(tmp_path / "own.csv", "".join(f"{t},{x},{cell}\n" for t, x, cell in rows))
    proposed = "--column time='column 1' --column displacement=COLUMN --column force=COLUMN"
    assert refusal(path).endswith(proposed)


def test_clock_that_repeats_times_is_proposed_before_a_motion_that_mostly_rises(tmp_path):
    clock = np.repeat(TIME_S[::3], 3)[: len(TIME_S)]
    way = np.linspace(0.0, 1.0, len(TIME_S))
    way[5] = -0.1
    message = refusal(saved(tmp_path / "own.csv", lines(way, clock, FORCE_N, FORCE_N)))
    assert message.endswith("--column time='column 2' --column displacement=COLUMN --column force=COLUMN")


def test_semicolon_at_the_end_of_each_row_is_no_part_of_the_last_column(tmp_path):
    header = "time_s, displacement_m, force_N;\n"
    rows = lines(TIME_S, WAY_M, FORCE_N).replace(",", ", ").replace("\n", ";\r\n")
    (channel,) = import_file(saved(tmp_path / "own.txt", header + rows)).channels
    np.testing.assert_allclose(channel.effort, FORCE_N, atol=1e-6)


def test_settings_that_never_change_are_not_proposed_as_the_motion(tmp_path):
    same = np.full(len(TIME_S), 0.5)
    header = "time_s,position_p,position_d,torque_Nm\n"
    message = refusal(saved(tmp_path / "own.csv", header + lines(TIME_S, 1e4 * same, same, FORCE_N)))
    assert "position_p" not in message.partition("by names")[2]
    assert "no column holds a position or displacement" in message


def test_proposed_columns_keep_the_units_that_are_given(tmp_path):
    path = saved(tmp_path / "own.csv", "time_s,w,load\n" + lines(TIME_S, WAY_M, FORCE_N))
    message = refusal(path, columns={"force_kN": "load"})
    assert message.endswith("--column displacement=COLUMN --column force=load --unit force=kN")
    path = saved(tmp_path / "own.csv", "time_s,position_1_mm,force_2_N\n" + lines(TIME_S, WAY_M, FORCE_N))
    assert refusal(path).endswith("--column displacement=position_1_mm --column force=force_2_N")


def test_a_column_without_any_cell_is_not_reported_as_invalid(tmp_path):
    rows = "".join(f"{t},{f},\n" for t, f in zip(TIME_S, FORCE_N, strict=True))
    path = saved(tmp_path / "title.csv", "Time (s),Load (N),D105\n" + rows)
    assert "--column displacement=COLUMN --column force='Load (N)'" in refusal(path)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_clock_and_one_column_are_a_table(tmp_path, delimiter):
    rows = [f"2018/12/07 17:44:{10 + 0.1 * n:06.3f}{delimiter}{n}.5\n" for n in range(9)]
    table = read_table(saved(tmp_path / "own.csv", "".join([f"Time{delimiter}Load N\n", *rows])))
    assert table.names == ("Time", "Load N")
    np.testing.assert_allclose(np.diff(table.numbers("Time")), 0.1)
    ended = saved(tmp_path / "end.csv", "".join([f"Time{delimiter}Load N\n", *rows, "2018/12/07 17:45:00\n"]))
    assert "a footer of 1 line" in read_table(ended).notes


_ALIGNED_HEADER = (
    "   No    Time   Depth   Pore 2    Load       Bq\n    -       s      mm      MPa       N        %\n"
)


def test_aligned_columns_may_have_empty_cells_and_names_with_blanks(tmp_path):
    rows = [f"{n:5} {0.1 * n:7.3f} {n:7.2f} {'' if n < 4 else n:8} {2.5 * n:7.2f}" for n in range(1, 20)]
    rows = [row if 2 < n < 9 else f"{row} {n:8}" for n, row in enumerate(rows)]
    for title in ("", " Data table:\n", "Measured by hand\n\n"):
        table = read_table(saved(tmp_path / "own.asc", title + _ALIGNED_HEADER + "\n".join(rows) + "\n"))
        assert table.names == ("No", "Time [s]", "Depth [mm]", "Pore 2 [MPa]", "Load [N]", "Bq [%]")
        assert "cells aligned in columns" in table.notes
        np.testing.assert_allclose(table.numbers("Load [N]"), 2.5 * np.arange(1, 20))
        assert table.filled_rows("Pore 2 [MPa]").tolist() == [False] * 3 + [True] * 16
        assert table.filled_rows("Bq [%]").tolist() == [True] * 3 + [False] * 6 + [True] * 10
    assert table.row_name(0) == "line 5"


@pytest.mark.parametrize(("separator", "order"), [(" ", 1), (",", -1)])
def test_unit_in_percent_may_end_or_begin_a_row_of_units(tmp_path, separator, order):
    header = (("Rec", "Time", "Depth", "Load", "Ratio"), ("No", "s", "mm", "N", "%"))
    rows = (*header, *((str(n), f"{0.1 * n:.3f}", str(n), str(3 * n), str(n)) for n in range(1, 20)))
    path = saved(tmp_path / "own.asc", "".join(separator.join(row[::order]) + "\n" for row in rows))
    names = ("Rec [No]", "Time [s]", "Depth [mm]", "Load [N]", "Ratio [%]")
    assert read_table(path).names == names[::order]


@pytest.mark.parametrize(
    ("names", "proposed"),
    [
        ("time_s,F_arm,M_arm", "--column displacement=COLUMN --column force=F_arm --unit force=N"),
        ("time_s,Acceleration [V],Load [V]", "--column displacement=COLUMN --column force='Load [V]'"),
        ("time_s,temp,AI0", "--column displacement_mm=COLUMN --column force_N=COLUMN; if another file"),
        (
            "Sample,temp,AI0",
            "force_N=COLUMN; if no column holds the time, add the interval of rows, such as --unit time=10ms",
        ),
        ("time_s,depth,AI0", "--column displacement=depth --unit displacement=mm --column force_N=COLUMN"),
        ("time_s,depth_pct,depth_smooth", "--column displacement=depth_pct --column force_N=COLUMN"),
    ],
)
def test_proposed_options_are_complete_and_prefer_words_to_volts(tmp_path, names, proposed):
    path = saved(tmp_path / "own.csv", names + "\n" + lines(TIME_S, WAY_M, FORCE_N))
    assert proposed in refusal(path)


def test_position_whose_first_cell_is_empty_is_proposed(tmp_path):
    rows = lines(TIME_S, WAY_M, FORCE_N).splitlines()
    rows[0] = f"{TIME_S[0]},,{FORCE_N[0]}"
    message = refusal(
        saved(
            tmp_path / "own.csv",
            "time_s,target pos,pos (1),load (1)\n"
            + "\n".join(f"{row.split(',')[0]},7,{row.split(',', 1)[1]}" for row in rows),
        )
    )
    assert "seems to hold" not in message
    assert "'pos (1)'" in message.partition("as in ")[2]


def test_reactive_power_is_not_a_position():
    names = ["power_meter.Q1", "power_meter.P1", "mechanical.torque"]
    assert [guess.quantity for guess in guess_columns(names)] == ["", "", "torque"]
