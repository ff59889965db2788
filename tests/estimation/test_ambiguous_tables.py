"""Tables that could be read as other numbers, or with fewer rows: each is refused or has a note."""

import shlex

import numpy as np
import openpyxl
import pytest

from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_files import import_files
from palpate.estimation.data.import_options import ImportOptions
from palpate.robot_io.errors import InputError
from tests.files import saved

TIME_S = np.arange(0.0, 0.4, 1e-3)
DEPTH_M = 3e-3 * np.sin(2.0 * np.pi * 5.0 * TIME_S) ** 2
FORCE_N = 2000.0 * DEPTH_M
HEADER = "time_s;displacement_m;force_N;note"


def rows(*columns, form="%.6f", note="ok"):
    return [";".join([*(form % value for value in row), note]) for row in zip(*columns, strict=True)]


def notes_of(path, header, *columns):
    path.write_text("\n".join([header, *rows(*columns)]), encoding="utf-8")
    return " ".join(import_file(path).notes)


@pytest.mark.parametrize("mark", [".", ","])
def test_thousands_separators_are_not_read_as_decimal_marks(tmp_path, mark):
    lines = [
        f"{time:.0f};{depth:,.0f};{force:,.0f}".replace(",", mark)
        for time, depth, force in zip(1e3 * TIME_S, 1e6 * DEPTH_M, 1e3 * FORCE_N, strict=True)
    ]
    with pytest.raises(InputError, match=r"line \d+, .*'displacement_um': '1.\d{3}' may mean 1.\d* or 1"):
        import_file(saved(tmp_path / "press.csv", "\n".join(["time_ms;displacement_um;force_mN", *lines])))


def test_rows_with_the_other_decimal_mark_are_not_a_footer(tmp_path):
    lines = rows(TIME_S, DEPTH_M, FORCE_N)
    lines[:200] = [line.replace(".", ",") for line in lines[:200]]
    channel = import_file(saved(tmp_path / "press.csv", "\n".join([HEADER, *lines]))).channels[0]
    np.testing.assert_allclose(channel.effort, FORCE_N, atol=1e-5)


def test_unclosed_quotation_mark_is_refused_and_a_multiline_quote_is_not(tmp_path):
    lines, path = rows(TIME_S, DEPTH_M, FORCE_N), tmp_path / "press.csv"
    whole = "\n".join([HEADER, *lines[:99], lines[99].replace("ok", '"5 mm probe'), *lines[100:]])
    path.write_text(whole, encoding="utf-8")
    with pytest.raises(InputError, match="line 101: a quotation mark opens a cell that holds 300 more lines"):
        import_file(path)
    path.write_text(whole.replace("5 mm probe", '5 mm probe;\n12;13"'), encoding="utf-8")
    assert len(import_file(path).channels[0].effort) == len(TIME_S)


def workbook(path, *header_rows, force):
    book = openpyxl.Workbook()
    for row in (*header_rows, *zip(TIME_S.tolist(), DEPTH_M.tolist(), force, strict=True)):
        book.active.append(row)
    book.save(path)
    return path


def test_text_with_thousands_separators_among_numbers_is_refused(tmp_path):
    force_mn = [f"{force:,.0f}" if force >= 1000.0 else force for force in (1e3 * FORCE_N).tolist()]
    path = workbook(tmp_path / "press.xlsx", ["time_s", "displacement_m", "force_mN"], force=force_mn)
    with pytest.raises(InputError, match=r"column 'force_mN': the text '1,\d{3}' may mean 1.\d+ or 1\d{3}"):
        import_file(path)


def test_units_row_that_contradicts_the_names_is_reported(tmp_path):
    header = ["time_s", "displacement_m", "force_N"]
    path = workbook(tmp_path / "press.xlsx", header, ["s", "m", "kN"], force=FORCE_N.tolist())
    notes = " ".join(import_file(path).notes)
    assert "'force_N [kN]' may state two units and is read in kN; if N is right, add --unit force=N" in notes
    (channel,) = import_file(path, ImportOptions(units={"force": "N"})).channels
    np.testing.assert_allclose(channel.effort, FORCE_N)
    path = workbook(
        tmp_path / "press.xlsx", ["Zeit in [s]", "Weg in [mm]", "Kraft N [N]"], force=FORCE_N.tolist()
    )
    (channel,) = import_file(path).channels
    np.testing.assert_allclose(channel.position, 1e-3 * DEPTH_M)


@pytest.mark.parametrize("name", ["Load x1000 (N)", "Load*10^3 [N]", "load_x1000_N"])
def test_factors_in_names_are_reported(tmp_path, name):
    notes = notes_of(
        tmp_path / "press.csv", f"Time (s);Displacement (m);{name};note", TIME_S, DEPTH_M, FORCE_N
    )
    assert "the factor" in notes
    assert f"'{name}' is ignored" in notes


def test_unrelated_derivative_is_not_used_and_a_constant_velocity_is(tmp_path):
    header = "time_s;displacement_m;velocity_m_s;force_N;note"
    for velocity in (np.zeros_like(TIME_S), np.sin(90.0 * TIME_S + 1.0)):
        notes = notes_of(tmp_path / "press.csv", header, TIME_S, DEPTH_M, velocity, FORCE_N)
        assert "'velocity_m_s' does not follow the rate of change of 'displacement_m'" in notes
    noisy = np.gradient(DEPTH_M, TIME_S) + np.random.default_rng(1).normal(0.0, 0.05, len(TIME_S))
    notes = notes_of(tmp_path / "press.csv", header, TIME_S, DEPTH_M, noisy, FORCE_N)
    assert "does not follow" not in notes
    header, wrong = "time_s;displacement_m;acceleration_m_s2;force_N;note", np.sin(90.0 * TIME_S + 1.0)
    notes = notes_of(tmp_path / "press.csv", header, TIME_S, DEPTH_M, wrong, FORCE_N)
    assert "'acceleration_m_s2' does not follow the rate of change of the velocity" in notes
    header, speed = "time_s;displacement_m;velocity_m_s;force_N;note", np.full_like(TIME_S, 0.02)
    notes = notes_of(tmp_path / "press.csv", header, TIME_S, 0.02 * TIME_S, speed, 40.0 * TIME_S)
    assert "does not follow" not in notes


def test_pause_longer_than_the_rest_of_the_run_is_reported(tmp_path):
    time_s = np.where(TIME_S > 0.15, TIME_S + 3600.0, TIME_S)  # at the largest depth
    notes = notes_of(tmp_path / "press.csv", HEADER, time_s, DEPTH_M, FORCE_N)
    assert "'time_s' jumps by 3600 s at line 153" in notes
    assert "jumps" not in notes_of(tmp_path / "press.csv", HEADER, TIME_S, DEPTH_M, FORCE_N)


@pytest.mark.parametrize(
    ("name", "scale", "differs"),
    [
        ("real_time", 2.0, True),
        ("real_time", 1e3, False),
        ("elapsed time [ms]", 2e3, True),
        ("lap", 2.0, False),
    ],
)
def test_clock_of_another_duration_is_reported(tmp_path, name, scale, differs):
    header, times = f"timestamp;{name};displacement_m;force_N;note", (TIME_S, scale * TIME_S + 7.0)
    notes = notes_of(tmp_path / "press.csv", header, *times, DEPTH_M, FORCE_N)
    assert (f"'{name}' is a clock too" in notes) is differs
    assert (f"--column time={shlex.quote(name)}" in notes) is differs


def test_unit_that_makes_numbers_too_large_is_refused(tmp_path):
    path = saved(tmp_path / "press.csv", "\n".join([HEADER, *rows(TIME_S, DEPTH_M, FORCE_N)]))
    with pytest.raises(InputError, match=r"column 'force_N' in 1e30N: .*N is too large a number"):
        import_file(path, ImportOptions(units={"force": "1e30N"}))


ANGLE, CURRENT = np.sin(20.0 * TIME_S), np.cos(20.0 * TIME_S)


def table_of(folder, header, *columns):
    path = folder / "table.csv"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9g")
    return path


def refusal(path):
    with pytest.raises(InputError) as caught:
        import_file(path)
    return str(caught.value)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("pos (5),current (5)", "--unit position=0.00153rad --unit torque=0.001A, the value of one count"),
        ("pos_1,pos_2,current_1", "--unit torque=0.001A, the value of one count"),
        ("position,load", "--unit position=0.001mm --unit force=0.001N, the value of one count"),
        ("position,load * 100", "--unit position=0.001mm --unit force=0.01N, the value of one count"),
        ("angle * 100,current", "--unit position=0.01deg --column torque=current --unit torque=0.001A"),
    ],
)
def test_whole_numbers_are_asked_for_the_value_of_one_count(tmp_path, names, said):
    columns = [np.round(2000.0 * ANGLE), *[np.round(100.0 * CURRENT)] * names.count(",")]
    path = table_of(tmp_path, f"time_s,{names}", TIME_S, *columns)
    assert said in refusal(path)
    rows = path.read_text(encoding="utf-8").splitlines()  # an empty cell must not hide the columns to choose
    rows[1] = f"{rows[1].split(',')[0]}{',' * (1 + names.count(','))}"
    assert said in refusal(saved(path, "\n".join(rows)))
    fractions = table_of(tmp_path, f"time_s,{names}", TIME_S, *(column + 0.5 for column in columns))
    assert "count" not in refusal(fractions)


def test_a_position_in_volts_is_asked_for_the_value_of_one_volt(tmp_path):
    path = table_of(tmp_path, "time_s,current_A,encoder_V", TIME_S, CURRENT, ANGLE)
    assert refusal(path).endswith("--unit position=FACTORrad/V, with the value of one volt as FACTOR")
    (channel,) = import_file(path, ImportOptions(units={"position": "0.5rad/V"})).channels
    np.testing.assert_allclose(channel.position, 0.5 * ANGLE, atol=1e-8)


def test_columns_that_occur_twice_are_tests_only_with_another_motion_and_effort(tmp_path):
    goals, joint = "target_current_0,target_current_1", "actual_q_0 [rad],actual_current_0 [A]"
    path = table_of(tmp_path, f"time_s,{joint},{goals},{goals}", TIME_S, ANGLE, CURRENT, *[CURRENT] * 4)
    assert len(import_file(path).channels[0].runs) == 1
    for factor, runs in ((1.0, 1), (2.0, 2)):
        columns = (ANGLE, CURRENT, ANGLE, factor * CURRENT)
        path = table_of(tmp_path, "time_s,q [rad],tau [Nm],q [rad],tau [Nm]", TIME_S, *columns)
        assert len(import_file(path).channels[0].runs) == runs


def test_only_a_column_that_increases_is_proposed_as_the_time(tmp_path):
    names = "interval(ms),time(ms),position_slave_deg,force_slave,position_master_deg"
    interval = 1.0 + np.arange(len(TIME_S)) % 3
    path = table_of(tmp_path, names, interval, np.cumsum(interval), ANGLE, CURRENT, CURRENT)
    assert "--column time='time(ms)' --column position" in refusal(path)
    columns = (interval, np.cumsum(interval), ANGLE, np.round(100.0 * CURRENT), CURRENT)
    assert refusal(table_of(tmp_path, names, *columns)).endswith("torque=0.001Nm, the value of one count")


def test_files_named_after_joints_are_proposed_as_joints(tmp_path):
    for name, columns in {"t": TIME_S, "q_filter": [ANGLE] * 2, "tau_filter": [CURRENT] * 2}.items():
        np.savetxt(tmp_path / f"{name}.txt", np.transpose(columns))
    several = "for several joints, as in --column position_1=COLUMN --column torque_1=COLUMN$"
    proposed = f"--column time=t --column position=COLUMN --column torque=COLUMN; {several}"
    with pytest.raises(InputError, match=proposed):
        import_files([tmp_path / f"{name}.txt" for name in ("q_filter", "t", "tau_filter")], ImportOptions())
