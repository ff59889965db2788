"""Logs of robots' own formats: joint states of ROS 2, and episodes of a LeRobot data set."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from mcap_ros2.writer import Writer

from estimation.data.channels import is_session
from estimation.data.import_file import import_file
from estimation.data.import_options import ImportOptions
from estimation.study.source import open_source
from robot_io.errors import InputError

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
TORQUE = np.column_stack([np.cos(5 * T), np.sin(3 * T)])


def write_bag(path, *, effort=True, swap_every=0):
    """Two joints; every so often their order changes, and a gripper speaks in between."""
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", DEFINITION)
        for row, t in enumerate(T):
            stamp = 1_700_000_000_123_456_789 + round(t * 1e9)
            order = [1, 0] if swap_every and row % swap_every else [0, 1]
            message = {
                "header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": ""},
                "name": [("shoulder", "elbow")[joint] for joint in order],
                "position": Q[row, order].tolist(),
                "velocity": [],
                "effort": TORQUE[row, order].tolist() if effort else [],
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
    assert [one.name for one in source.channels] == ["joint_1", "joint_2"]
    assert "'shoulder'" in source.read
    for joint, channel in enumerate(source.channels):
        np.testing.assert_allclose(channel.time_s, T, atol=1e-8)
        np.testing.assert_allclose(channel.position, Q[:, joint])
        np.testing.assert_allclose(channel.effort, TORQUE[:, joint])


def test_joint_states_without_effort_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"/joint_states' has no effort"):
        import_file(write_bag(tmp_path / "bag.mcap", effort=False))


def test_a_ros_recording_that_is_cut_or_of_other_things_is_refused(tmp_path):
    whole = write_bag(tmp_path / "bag.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.mcap: "):
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


def test_an_episode_s_arrays_are_joints(episode):
    with pytest.raises(InputError, match=r"do not say their units.*--unit position_1=deg"):
        import_file(episode)
    imported = import_file(episode, ImportOptions(units={"position": "deg", "torque": "Nm"}))
    assert imported.run_labels == {4: "4", 5: "5"}
    assert "shoulder_pan, elbow_flex" in imported.read
    for joint, channel in enumerate(imported.channels):
        np.testing.assert_allclose(channel.position, Q[:, joint])
        np.testing.assert_allclose(channel.effort, TORQUE[:, joint])


def test_an_action_is_an_effort_only_by_the_user_s_word(episode):
    columns = {"torque_1_Nm": "action_1", "torque_2_Nm": "action_2"}
    options = ImportOptions(columns=columns, units={"position": "deg"})
    np.testing.assert_allclose(import_file(episode, options).channels[0].effort, np.degrees(Q + 0.01)[:, 0])
