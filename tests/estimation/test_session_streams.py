import numpy as np
import pytest

from palpate.estimation.data.channels import import_extra, import_streams, run_labels, session_channels
from palpate.estimation.data.file_columns import is_session
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.study.source import open_source
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Column, Session, SessionMetadata, Stream, write_session
from tests.estimation.little_probe import kelvin_voigt, probe, ticks
from tests.files import write_csv

T = np.arange(40) * 0.01
FIELDS = ("time_s", "position", "velocity", "acceleration", "effort", "run", "phase")


def imported(tmp_path):
    columns = {
        "time_s": np.tile(T, 2),
        "displacement_m": 0.001 + np.tile(T, 2) ** 2,
        "force_N": np.tile(T, 2),
        "position_1_rad": np.sin(np.tile(T, 2)),
        "torque_1_Nm": np.cos(np.tile(T, 2)),
        "position_2_m": np.cos(np.tile(T, 2)),
        "force_2_N": np.cos(np.tile(T, 2)),
        "run": ["first"] * 40 + ["second"] * 40,
        "room temperature": 20 + np.tile(T, 2),
    }
    path = write_csv(tmp_path / "all.csv", columns)
    return import_file(path, ImportOptions(context=("room temperature",)))


def test_session_gives_back_the_arrays_that_were_imported(tmp_path):
    before = imported(tmp_path)
    metadata = SessionMetadata(extra=import_extra(before))
    path = write_session(tmp_path / "session.mcap", import_streams(before), metadata)
    after = open_source(path).channels
    assert [c.name for c in after] == ["contact", "joint_1", "joint_2"]
    for one, other in zip(before.channels, after, strict=True):
        assert one.kind is other.kind
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
        assert set(one.context) == set(other.context)
        for name, values in one.context.items():
            np.testing.assert_array_equal(values, other.context[name])
    assert "room_temperature" in after[0].context
    assert Session.open(path).metadata.extra["run_labels"] == '{"0": "first", "1": "second"}'


def test_session_knows_the_run_names_of_its_data_file(tmp_path):
    before = imported(tmp_path)
    metadata = SessionMetadata(extra=import_extra(before))
    write_session(tmp_path / "session.mcap", import_streams(before), metadata)
    for one, other in zip(
        open_source(tmp_path / "all.csv", ImportOptions(where={"run": "second"})).channels,
        open_source(tmp_path / "session.mcap", ImportOptions(where={"run": "second"})).channels,
        strict=True,
    ):
        np.testing.assert_array_equal(one.effort, other.effort)


@pytest.mark.parametrize("labels", ["[", "[" * 9999, "[]", '{"0": 5, "x": "a", "9999999999999999999": "b"}'])
def test_invalid_run_names_name_nothing(labels, tmp_path):
    path = write_session(tmp_path / "x.mcap", [], SessionMetadata(extra={"run_labels": labels}))
    assert run_labels(Session.open(path)) == {}


def test_number_that_is_another_run_s_name_is_refused(tmp_path):
    metadata = SessionMetadata(extra={"run_labels": '{"0": "1", "1": "01"}'})
    write_session(tmp_path / "x.mcap", import_streams(imported(tmp_path)), metadata)
    for name, numbers in (("0", [0]), ("01", [1])):
        (channel, *_) = open_source(tmp_path / "x.mcap", ImportOptions(where={"run": name})).channels
        assert channel.runs.tolist() == numbers
    with pytest.raises(InputError, match=r"run=1: .* Available: 0, 01"):
        open_source(tmp_path / "x.mcap", ImportOptions(where={"run": "1"}))


def test_columns_have_units(tmp_path):
    streams = {stream.name: stream for stream, _ in import_streams(imported(tmp_path))}
    units = {column.name: column.unit for column in streams["joint_1"].columns}
    assert units["position_rad"] == "rad"
    assert units["acceleration_rad_s2"] == "rad/s^2"
    assert units["torque_nm"] == "N m"


def test_probing_session_gives_contact_and_joints(tmp_path):
    samples = ticks(probe(kelvin_voigt(800.0, 30.0), speeds=(0.1,)))
    metadata, streams = SessionMetadata(software_version="0"), [(samples.stream, dict(samples.columns))]
    channels = open_source(write_session(tmp_path / "probe.mcap", streams, metadata)).channels
    assert [c.name for c in channels] == ["contact", "joint_1", "joint_2", "joint_3"]
    assert channels[0].surface is not None


def test_session_without_channels_is_reported(tmp_path):
    stream = Stream("noise", (Column("time_s", "s"),))
    path = write_session(tmp_path / "other.mcap", [(stream, {"time_s": T})], SessionMetadata())
    with pytest.raises(InputError, match="no stream holds samples of a run; its streams: noise"):
        session_channels(Session.open(path))


def test_session_is_identified_by_its_content(tmp_path):
    disguised = tmp_path / "session.csv"
    before = imported(tmp_path)
    write_session(tmp_path / "s.mcap", import_streams(before), SessionMetadata()).rename(disguised)
    assert is_session(disguised)
    assert not is_session(tmp_path / "all.csv")
    assert is_session(tmp_path / "absent.mcap")
    assert not is_session("/proc/self/mem")  # which cannot be read from its beginning
