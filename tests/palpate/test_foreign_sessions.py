"""Foreign sessions: missing, malformed and nonfinite data are reported in one line."""

import numpy as np
import pytest

from palpate.control.loop.tick_record import tick_stream
from palpate.estimation.data.channels import session_channels
from palpate.estimation.data.tick_channels import checked_ticks
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Column, Session, SessionMetadata, Stream, write_session
from palpate.robot_io.types import Status
from tests.palpate import synthetic
from tests.palpate.cli import assert_refused, run
from tests.palpate.sessions import synthetic_session

READERS = (checked_ticks, session_channels)


def session_of(path, columns, data):
    return Session.open(write_session(path, [(Stream("tick", tuple(columns)), data)], SessionMetadata()))


def columns_and_data():
    columns = tick_stream(3).columns
    known = synthetic.ticks((0.15,))
    return columns, {column.name: np.array(known[column.name]) for column in columns}


def assert_nobody_reads(session, match):
    for reader in READERS:
        with pytest.raises(InputError, match=match):
            reader(session)


@pytest.mark.parametrize(
    "name", ["force_n", "phase", "run", "joint_position_rad", "torque_measured_nm", "surface_m"]
)
def test_missing_column_is_named(name, tmp_path):
    columns, data = columns_and_data()
    del data[name]
    session = session_of(tmp_path / "x.mcap", [c for c in columns if c.name != name], data)
    assert_nobody_reads(session, rf"x\.mcap, stream 'tick': no column '{name}'")


@pytest.mark.parametrize("name", ["encoder_at_s", "torque_at_s", "force_at_s"])
def test_sample_of_another_clock_is_named(name, tmp_path):
    columns, data = columns_and_data()
    data[name][7] = 1e18
    session = session_of(tmp_path / "x.mcap", columns, data)
    assert_nobody_reads(session, rf"tick 8, column .{name}.: 1e\+18 s is far")


def test_unordered_ticks_are_reported(tmp_path):
    columns, data = columns_and_data()
    session = session_of(tmp_path / "good.mcap", columns, data)
    assert all(len(reader(session)) > 0 for reader in READERS)
    middle = len(data["run"]) // 2
    halves = {name: np.roll(values, middle, axis=0) for name, values in data.items()}
    session = session_of(tmp_path / "x.mcap", columns, halves)
    assert_nobody_reads(session, r"tick \d+, column 'time_s': is .* s earlier than the previous tick")


@pytest.mark.parametrize(
    ("device", "change"),
    [("encoder", np.zeros_like), ("torque", np.flip), ("force", lambda time_s: time_s // 0.1 * 0.1)],
)
def test_stopped_clock_is_reported(change, device, tmp_path):
    columns, data = columns_and_data()
    data[f"{device}_at_s"] = change(data[f"{device}_at_s"])
    with pytest.raises(InputError, match=r"times .*do not increase from sample to sample"):
        session_channels(session_of(tmp_path / "x.mcap", columns, data))


def _frozen(time_s, middle):
    time_s[middle : middle + 20] = time_s[middle]


def _set_back(time_s, middle):
    time_s[middle:] -= 0.01


@pytest.mark.parametrize("change", [_frozen, _set_back])
@pytest.mark.parametrize("device", ["encoder", "torque", "force"])
def test_clock_that_stops_or_goes_back_for_a_moment_is_reported(change, device, tmp_path):
    columns, data = columns_and_data()
    change(data[f"{device}_at_s"], len(data["run"]) // 2)
    session = session_of(tmp_path / "x.mcap", columns, data)
    assert_nobody_reads(
        session, rf"tick \d+, column '{device}_at_s': the times of good samples do not increase"
    )


def test_unused_signals_may_be_missing(tmp_path):
    columns, data = columns_and_data()
    for name in ("tick", "lateness_s", "log_s", "joint_velocity_rad_s"):
        del data[name]
    path = tmp_path / "x.mcap"
    session_of(path, [column for column in columns if column.name in data], data)
    assert run("inspect", path, "--save", tmp_path / "x.rrd").exit_code == 0


@pytest.mark.parametrize(
    ("name", "width", "dtype", "words"),
    [
        ("torque_measured_nm", 1, "float64", "1 values a tick, expected 3"),
        ("joint_position_rad", 1, "float64", "3 values a tick, expected 1"),
        ("tip_position_world_m", 2, "float64", "2 values a tick, expected 3"),
        ("force_n", 2, "float64", "2 values a tick, expected 1"),
        ("phase", 1, "float64", "is float64, expected int32"),
    ],
)
def test_column_of_another_form_is_named(name, width, dtype, words, tmp_path):
    columns, data = columns_and_data()
    changed = [Column(c.name, c.unit, width, c.doc, dtype) if c.name == name else c for c in columns]
    data[name] = np.zeros((len(data["run"]), width) if width > 1 else len(data["run"]), dtype)
    with pytest.raises(InputError, match=rf"x\.mcap, stream 'tick', column '\w+': {words}"):
        checked_ticks(session_of(tmp_path / "x.mcap", changed, data))


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("joint_position_rad", np.nan, "nan is not a finite number"),
        ("force_n", 1e300, r"1e\+300 is too large a number"),
        ("force_n", -np.inf, "-inf is not a finite number"),
        ("torque_measured_nm", np.inf, "inf is not a finite number"),
        ("press_direction_world", np.nan, "nan is not a finite number"),
        ("force_at_s", np.nan, "nan is not a finite number"),
        ("time_s", np.nan, "nan is not a finite number"),
    ],
)
def test_error_for_a_nan_names_its_tick(name, value, words, tmp_path):
    columns, data = columns_and_data()
    data[name][[700, 702]] = value
    session = session_of(tmp_path / "x.mcap", columns, data)
    with pytest.raises(InputError, match=rf"x\.mcap: tick 701, column '{name}': {words} \(1 more like it\)"):
        checked_ticks(session)


def test_invalid_sample_may_hold_anything(tmp_path):
    columns, data = columns_and_data()
    data["force_n"][700] = np.nan
    data["force_status"][700] = Status.FAULT
    data["tip_position_world_m"][10] = np.nan
    data["run"][10] = -1
    assert session_channels(session_of(tmp_path / "x.mcap", columns, data))[0].name == "contact"


@pytest.mark.parametrize("device", ["encoder", "torque", "force"])
def test_device_without_a_good_sample_is_no_file_fault(device, tmp_path):
    columns, data = columns_and_data()
    data[f"{device}_status"][:] = Status.STALE
    assert len(checked_ticks(session_of(tmp_path / "x.mcap", columns, data)))


def test_session_without_a_tick_is_checked_too(tmp_path):
    columns, data = columns_and_data()
    empty = session_of(tmp_path / "x.mcap", columns, {name: values[:0] for name, values in data.items()})
    assert len(checked_ticks(empty)) == 0


def test_commands_refuse_in_one_line(tmp_path):
    columns, data = columns_and_data()
    data["joint_position_rad"][900, 1] = np.nan
    session_of(tmp_path / "x.mcap", columns, data)
    for command in ("estimate", "inspect", "diagnose"):
        assert_refused(run(command, tmp_path / "x.mcap"), "x.mcap: tick 901", "joint_position_rad")


@pytest.mark.parametrize(
    "urdf", ["no URDF", "<!DOCTYPE r [<!ENTITY a 'b'>]><robot name='&a;'>&a;", "<robot/>"]
)
def test_undrawable_urdf_is_one_line(urdf, tmp_path, capfd):
    synthetic_session(tmp_path / "x.mcap", urdf=urdf)
    result = run("inspect", tmp_path / "x.mcap", "--save", tmp_path / "x.rrd")
    assert_refused(result, "session 'x': its URDF cannot be shown")
    assert capfd.readouterr().err == ""  # nor a word from the viewer's library
    assert not (tmp_path / "x.rrd").exists()


MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
TEXTURE = (
    '<visual><geometry><box size="1 1 1"/></geometry>'
    '<material name="m"><texture filename="{}"/></material></visual>'
)


def test_files_named_by_a_session_s_urdf_are_not_read(tmp_path):
    secret = tmp_path / "secret.stl"
    secret.write_text("solid KEEP-THIS\nendsolid KEEP-THIS\n")
    meshes = map(MESH.format, (secret, f"file://{secret}", f"../../../../../..{secret}"))
    urdf = synthetic.urdf().replace("</link>", "".join([*meshes, TEXTURE.format(secret), "</link>"]), 1)
    synthetic_session(tmp_path / "x.mcap", urdf=urdf)
    assert run("inspect", tmp_path / "x.mcap", "--save", tmp_path / "x.rrd").exit_code == 0
    assert b"KEEP-THIS" not in (tmp_path / "x.rrd").read_bytes()


def imported(rows):
    """Columns and data of the stream that an imported contact has."""
    names = ("time_s", "displacement_m", "velocity_m_s", "acceleration_m_s2", "force_n")
    columns = [Column(each, "1") for each in names]
    columns += [Column("run", "1", 1, "", "int64"), Column("phase", "1", 1, "", "int32")]
    data = {each: np.linspace(0, 1, rows) for each in names}
    return columns, data | {"run": np.zeros(rows, np.int64), "phase": np.full(rows, -1, np.int32)}


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("force_n", np.nan, "nan is not a finite number"),
        ("displacement_m", 1e300, "too large"),
        ("run", None, "no column 'run'"),
        ("time_s", slice(None), "times must increase within a run"),
        ("time_s", slice(7), "times must increase within a run"),
    ],
)
def test_imported_stream_is_checked_too(name, value, words, tmp_path):
    columns, data = imported(50)
    if value is None:
        del data[name]
        columns = [column for column in columns if column.name != name]
    elif isinstance(value, slice):
        data[name][value] = 0.0
    else:
        data[name][7] = value
    path = write_session(tmp_path / "x.mcap", [(Stream("contact", tuple(columns)), data)], SessionMetadata())
    with pytest.raises(InputError, match=r"x\.mcap, stream 'contact'") as caught:
        session_channels(Session.open(path))
    assert words in str(caught.value)


def test_imported_stream_without_samples_shows_nothing(tmp_path):
    columns, data = imported(0)
    write_session(tmp_path / "x.mcap", [(Stream("contact", tuple(columns)), data)], SessionMetadata())
    assert_refused(
        run("inspect", tmp_path / "x.mcap", "--save", tmp_path / "x.rrd"), "nothing that can be shown"
    )
