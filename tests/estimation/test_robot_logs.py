"""Logs of robots' own formats: joint states of ROS 2, and episodes of a LeRobot data set."""

import json
import sqlite3
import struct
from contextlib import closing

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from mcap.reader import make_reader
from mcap_ros2.writer import Writer

from palpate.estimation.data.column_names import guess_column
from palpate.estimation.data.file_columns import is_session
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.study.source import open_source
from palpate.robot_io.errors import InputError
from tests.estimation import press_tables

DEFINITION = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""
T = np.arange(400) * 0.005
Q = np.column_stack([np.sin(5 * T), np.cos(3 * T)])
TORQUE = np.column_stack([np.cos(5 * T), -np.sin(3 * T)])  # of two dampers


def assert_are_the_joints(channels, time_s=None):
    assert [one.name for one in channels] == ["joint_1", "joint_2"]
    for joint, channel in enumerate(channels):
        np.testing.assert_allclose(channel.position, Q[:, joint], atol=1e-9)
        np.testing.assert_allclose(channel.effort, TORQUE[:, joint], atol=1e-9)
        if time_s is not None:
            np.testing.assert_allclose(channel.time_s, time_s, atol=1e-8)


def write_bag(path, *, torque=TORQUE, stamped=True, swap_every=0):
    """Two joints; every so often their order changes, and a gripper speaks in between."""
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", DEFINITION)
        for row, t in enumerate(T):
            stamp = 1_700_000_000_123_456_789 + round(t * 1e9)
            order = [1, 0] if swap_every and row % swap_every else [0, 1]
            message = {
                "header": {
                    "stamp": {"sec": stamped * stamp // 10**9, "nanosec": stamped * stamp % 10**9},
                    "frame_id": "",
                },
                "name": [("shoulder", "elbow")[joint] for joint in order],
                "position": Q[row, order].tolist(),
                "velocity": [],
                "effort": [] if torque is None else torque[row, order].tolist(),
            }
            writer.write_message("/joint_states", schema, message, log_time=stamp, publish_time=stamp)
            if row % 40 == 0:
                gripper = message | {"name": ["gripper"], "position": [0.1], "effort": [0.0]}
                writer.write_message("/joint_states", schema, gripper, log_time=stamp, publish_time=stamp)
        writer.finish()
    return path


@pytest.mark.parametrize("swap_every", [0, 3])
def test_joint_states_are_joints_in_the_order_of_the_first_message(tmp_path, swap_every):
    path = write_bag(tmp_path / "bag.mcap", swap_every=swap_every)
    assert not is_session(path)
    source = open_source(path)
    assert "'shoulder'" in source.read
    assert_are_the_joints(source.channels, T)


ONE_IS_NONE = np.where((np.arange(len(T)) == 5)[:, None] & [False, True], np.nan, TORQUE)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"torque": None}, "has no effort, which"),
        ({"torque": ONE_IS_NONE}, "has no finite effort of joint 'elbow' in 1 of 400 messages"),
        ({"stamped": False}, "every message has the same header.stamp"),
    ],
)
def test_incomplete_joint_states_are_refused(tmp_path, changed, words):
    with pytest.raises(InputError, match=f"/joint_states':? {words}"):
        import_file(write_bag(tmp_path / "bag.mcap", **changed))


def test_truncated_or_unrelated_ros_recording_is_refused(tmp_path):
    whole = write_bag(tmp_path / "bag.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.mcap: cannot be read: .* cut off \(EndOfFile\)"):
        import_file(cut)
    empty = tmp_path / "empty.mcap"
    with empty.open("wb") as file:
        Writer(file).finish()
    with pytest.raises(InputError, match="no messages of type sensor_msgs/msg/JointState"):
        import_file(empty)


@pytest.fixture
def episode(tmp_path):
    """Two episodes in one file, beside the description of their data set."""
    folder = tmp_path / "set" / "data" / "chunk-000"
    folder.mkdir(parents=True)
    meta = tmp_path / "set" / "meta"
    meta.mkdir()
    names = {"motors": ["shoulder_pan", "elbow_flex"]}
    (meta / "info.json").write_text(json.dumps({"features": {"observation.state": {"names": names}}}))
    columns = {
        "timestamp": pa.array(np.tile(T[:200], 2).astype(np.float32)),
        "episode_index": np.repeat([4, 5], 200),
        "observation.state": pa.array(np.degrees(Q).tolist(), pa.list_(pa.float64(), 2)),
        "action": pa.array(np.degrees(Q + 0.01).tolist()),
        "observation.effort": pa.array(TORQUE.tolist()),
    }
    path = folder / "episode_000000.parquet"
    pa.parquet.write_table(pa.table(columns), path)
    return path


def test_episode_arrays_are_joints_and_an_action_is_an_effort_on_request(episode):
    with pytest.raises(InputError, match=r"state no units.*--unit position=deg --unit torque=Nm"):
        import_file(episode)
    imported = import_file(episode, ImportOptions(units={"position": "deg", "torque": "Nm"}))
    assert imported.run_labels == {4: "4", 5: "5"}
    assert "shoulder_pan, elbow_flex" in imported.read
    assert_are_the_joints(imported.channels)
    columns = {"torque_1_Nm": "action_1", "torque_2_Nm": "action_2"}
    options = ImportOptions(columns=columns, units={"position": "deg"})
    np.testing.assert_allclose(import_file(episode, options).channels[0].effort, np.degrees(Q + 0.01)[:, 0])


def store(path, messages, topics=(("/js", "sensor_msgs/msg/JointState"),)):
    """A recording in SQLite: messages (topic number from 1 on, time [ns], bytes)."""
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA synchronous=OFF")  # no need to flush to disk
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp INTEGER, data)")
        database.executemany("INSERT INTO topics(name, type) VALUES (?, ?)", topics)
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", messages)
        database.commit()


def as_sqlite(bag, path, rows=slice(None)):
    """The same messages as rosbag2's older storage has them."""
    with bag.open("rb") as file:
        messages = [(1, m.log_time, m.data) for _, _, m in make_reader(file).iter_messages()][rows]
    topics = (("/joint_states", "sensor_msgs/msg/JointState"), ("/rosout", "rcl_interfaces/msg/Log"))
    store(path, [(2, 0, b"\0"), *messages], topics)


def test_sqlite_bag_in_several_files_equals_one_mcap(tmp_path):
    whole = import_file(write_bag(tmp_path / "one.mcap"))
    folder = tmp_path / "bag"
    folder.mkdir()
    for number in range(12):
        as_sqlite(tmp_path / "one.mcap", folder / f"bag_{number}.db3", slice(40 * number, 40 * number + 40))
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:")
    (tmp_path / "one.mcap").unlink()
    for place in (folder, tmp_path / "all.db3"):
        if place.suffix:
            write_bag(tmp_path / "two.mcap")
            as_sqlite(tmp_path / "two.mcap", place)
        for one, other in zip(whole.channels, open_source(place).channels, strict=True):
            np.testing.assert_array_equal(one.effort, other.effort)
            np.testing.assert_array_equal(one.time_s, other.time_s)


def test_database_with_unmerged_messages_is_refused(tmp_path):
    path, beside = tmp_path / "all.db3", tmp_path / "all.db3-wal"
    as_sqlite(write_bag(tmp_path / "one.mcap"), path)
    beside.touch()
    assert len(import_file(path).channels) == 2
    beside.write_bytes(b"messages")
    with pytest.raises(InputError, match=r"all\.db3: messages are still in all\.db3-wal.*wal_checkpoint"):
        import_file(path)


def test_big_endian_numbers_are_read(tmp_path):
    """CDR may be written either way round: the second byte says which."""
    names = b"".join(struct.pack(">I4s", 3, name) for name in (b"ab", b"cd"))
    path = tmp_path / "big.db3"
    messages = []
    for row, (q, torque) in enumerate(zip(Q, TORQUE, strict=True)):
        data = b"\0\0\0\0" + struct.pack(">iI", 1_700_000_000 + row, 5) + struct.pack(">I4s", 1, b"\0\0\0\0")
        data += struct.pack(">I", 2) + names + struct.pack(">I", 2) + struct.pack(">2d", *q)
        data += struct.pack(">II", 0, 2) + struct.pack(">2d", *torque)
        messages.append((1, row, data))
    store(path, messages)
    assert_are_the_joints(import_file(path).channels, np.arange(len(Q)))


@pytest.mark.parametrize("data", [None, "text", b"", b"\0\1\0\0" + b"\xff" * 60, b"\0\1\0\0" + b"\0" * 20])
def test_invalid_message_is_named_with_its_topic(tmp_path, data):
    path = tmp_path / "broken.db3"
    store(path, [(1, 0, data)])
    with pytest.raises(InputError, match="topic '/js' is cut off or is not a sensor_msgs/msg/JointState"):
        import_file(path)


def test_view_in_place_of_a_table_is_not_queried(tmp_path):
    path = tmp_path / "endless.db3"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT)")
        database.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
            "SELECT 1 AS topic_id, i AS timestamp, x'00' AS data FROM n"
        )
    with pytest.raises(InputError, match="lacks the tables 'topics' and 'messages'"):
        import_file(path)


@pytest.mark.parametrize(
    ("names", "effort"),
    [
        ("/joint_states/{}/position /joint_states/{}/effort", "torque"),
        ("/joint_states/position[{}] /joint_states/effort[{}]", "torque"),
        ("q[{}] tau_J[{}]", "torque"),
        ("position_{}_rad torque_{}_Nm", "torque"),
        ("{}_position[deg] {}_torque[mNm]", "torque"),
        ("actual_q_{} actual_current_{}", "current"),
    ],
)
def test_joints_are_identified_by_interface_names(names, effort):
    in_degrees = "[deg]" in names
    joints = ("shoulder", "elbow") if "{}/" in names or in_degrees else (0, 1)
    columns = {"timestamp": 1_700_000_000 + T, "target_q_0": T, "gripper_position": T}
    for joint, called in enumerate(joints):
        position, torque = names.format(called, called).split()
        columns[position] = np.degrees(Q[:, joint]) if in_degrees else Q[:, joint]
        columns[torque] = (1e3 if in_degrees else 1.0) * TORQUE[:, joint]
    imported = press_tables.imported(**columns)
    assert_are_the_joints(imported.channels)
    assert any("current used as the torque" in note for note in imported.notes) == (effort == "current")


@pytest.mark.parametrize("name", ["acceleration_1_rad_s2", "acc [rad/s^2]", "Beschleunigung [rad/s²]"])
def test_accelerations_may_accompany_named_columns(name):
    columns = {"time_s": T, "position_1_rad": Q[:, 0], "tau1 [Nm]": TORQUE[:, 0], name: -25.0 * Q[:, 0]}
    (found,) = press_tables.imported(**columns).channels
    assert (found.acceleration == pytest.approx(-25.0 * Q[:, 0])) is name.startswith("acceleration")


@pytest.mark.parametrize(
    "names",
    [
        "time_s,displacement_mm,temperature_C,sweep_index",
        "timestamp,total_angle,samples",
        "time_s,theta_deg,energy_J,subject",
        "time,lc1,lc2,status",
        "EnggStrain,TrueStrain",
    ],
)
def test_no_column_is_proposed_as_a_force_against_its_name(tmp_path, names):
    columns = np.cumsum(np.random.default_rng(0).random((len(names.split(",")), 50)), axis=1)
    said = refused_table(tmp_path / "own.csv", names, columns)
    assert "no column holds a force or torque" in said
    assert names.replace(",", ", ") in said
    assert not any(f"{effort}={name}" in said for name in names.split(",") for effort in ("force", "torque"))


def refused_table(path, names, columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=names, comments="")
    return press_tables.refusal(path)


def test_speeds_and_torques_of_named_motors_are_joints_and_the_proposed_units_can_be_read(tmp_path):
    """A row counter was proposed as a displacement, and then a speed in m/s beside a torque."""
    path, names = tmp_path / "dyno.csv", ",in_speed,in_torque,volts,out_speed,out_torque"
    speed = np.cos(5.0 * T)
    columns = [np.arange(len(T)), speed, 2.0 * speed, 0.1 * T, 3.0 * speed, 4.0 * speed]
    assert refused_table(path, names, columns).endswith("--unit velocity=rad_s --unit torque=Nm")
    options = ImportOptions(units={"velocity": "rad_s", "torque": "Nm"})
    found = import_file(path, options)
    slow, fast = found.channels
    np.testing.assert_allclose([slow.velocity, fast.velocity], [speed, 3.0 * speed])
    np.testing.assert_allclose([slow.effort, fast.effort], [2.0 * speed, 4.0 * speed])
    assert all(any(f"--column position_{joint}=" in note for note in found.notes) for joint in (1, 2))


@pytest.mark.parametrize(
    ("names", "proposed"),
    [
        ("time_s,tau,tauIden", "--column position=COLUMN --column torque=tau --unit torque=Nm"),
        ("time_s,Torque [Nm],temp", "--column position=COLUMN --column torque='Torque [Nm]'"),
        ("time_s,Fx,Fz,Tx,Ty,Tz", "--column displacement=COLUMN --column force=Fz --unit force=N"),
        (
            "time_s,pos 1,vel 1,pos 2,F 1",
            "--column position='pos 1' --unit position=m --column force='F 1' --unit force=N",
        ),
        (
            "time_s,Wheel velocity [m/s],Drive voltage [V]",
            "--column velocity='Wheel velocity [m/s]' --column force='Drive voltage [V]'",
        ),
        (
            "time_s,Speed [rad/s],Drive voltage [V]",
            "--column velocity='Speed [rad/s]' --column torque='Drive voltage [V]' --unit torque=1Nm",
        ),
        ("time_s,force,Frame", "--column displacement=COLUMN --column force=force --unit force=N"),
        (
            "time_ms,position_slave,force_slave,position_slave_deg,position_master_deg",
            "--column position=position_slave_deg --column torque=force_slave --unit torque=Nm",
        ),
    ],
)
def test_proposed_columns_fit_the_effort_of_the_file(tmp_path, names, proposed):
    columns = [T, *np.cumsum(np.random.default_rng(0).random((names.count(","), len(T))), axis=1)]
    assert refused_table(tmp_path / "own.csv", names, columns).endswith(proposed)


def test_pulse_width_is_no_clock_and_a_period_is(tmp_path):
    path = tmp_path / "log.csv"
    for name, is_clock in (("PWM (us)", False), ("period (us)", True)):
        assert (guess_column(name).quantity == "time") is is_clock
    names, columns = "PWM (us),speed [rpm],torque [Nm]", np.column_stack([1e3 + T, 1e3 * T, T])
    np.savetxt(path, columns, delimiter=",", header=names, comments="")
    assert import_file(path).roles == {"speed [rpm]": "velocity in rpm", "torque [Nm]": "torque in Nm"}


def test_data_set_folder_is_its_episodes(episode):
    options = ImportOptions(units={"position": "deg", "torque": "Nm"})
    source = open_source(episode.parents[2], options)
    np.testing.assert_array_equal(source.channels[1].effort, import_file(episode, options).channels[1].effort)


def test_vector_observation_is_split_by_its_element_names(tmp_path):
    """LeRobot 0.6 records one array; the arm is palpate's own, whose units and sample times are known."""
    folder, meta = tmp_path / "data" / "chunk-000", tmp_path / "meta"
    folder.mkdir(parents=True)
    meta.mkdir()
    v = np.gradient(Q, T, axis=0)
    names = ["b.pos", "a.pos", "b.vel", "a.vel", "b.torque", "a.torque", "force", "time", "base.vel"]
    features = {"observation.state": {"names": names}, "action": {"names": ["b.pos", "a.pos"]}}
    info = {"robot_type": "palpate", "features": features}
    (meta / "info.json").write_text(json.dumps(info))
    force, base = np.zeros((len(T), 1)), np.ones((len(T), 1))
    state = np.hstack([np.degrees(Q), np.degrees(v), TORQUE, force, T[:, None], base])
    columns = {"timestamp": 1.1 * T, "observation.state": state.tolist(), "action": np.degrees(Q).tolist()}
    pa.parquet.write_table(pa.table(columns), folder / "file-000.parquet")
    imported = import_file(folder / "file-000.parquet")
    assert_are_the_joints(imported.channels, T)
    assert imported.channels[0].velocity[5:-5] == pytest.approx(v[5:-5, 0], abs=1e-3)
    info["robot_type"] = "so_follower"
    (meta / "info.json").write_text(json.dumps(info))
    with pytest.raises(InputError, match="units"):
        import_file(folder / "file-000.parquet")
