"""Joint states of ROS 2, as rosbag2 writes them: MCAP or SQLite, in one file or in the files of a folder."""

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from estimation.data.file_columns import FileColumns
from estimation.data.ros_bag import messages_of
from robot_io.errors import InputError
from robot_io.types import FloatArray

_TYPE = "sensor_msgs/msg/JointState"
_ARRAYS = {"position": "position_{}_rad", "velocity": "velocity_{}_rad_s", "torque": "torque_{}_Nm"}
_CDR_BYTES = 4  # before the first field: how numbers are written
_STAMP_BYTES = 8  # seconds and nanoseconds
_NANO = 10**9
_MOST_KINDS = 1000


@dataclass(frozen=True)
class _Alike:
    """Messages of one topic that differ in nothing but numbers."""

    topic: str
    joints: tuple[str, ...]
    begins: bytes  # how the numbers are written
    text: bytes  # name of a frame and of the joints, as they stand behind the time stamp
    size: int  # of each message [bytes]
    places: dict[str, int]  # byte at which each array begins that has a number for each joint
    messages: list[bytes] = field(default_factory=list)

    def takes(self, message: bytes) -> bool:
        """Whether a message is one of these."""
        first = _CDR_BYTES + _STAMP_BYTES
        return (
            len(message) == self.size
            and message.startswith(self.begins)
            and message[first : first + len(self.text)] == self.text
        )

    def numbers(self, kind: str, place: int, count: int) -> NDArray[Any]:
        """Numbers of each message from a byte on, shape (messages, count)."""
        size = np.dtype(kind).itemsize * count
        order = "<" if self.begins[1] & 1 else ">"
        whole = np.frombuffer(b"".join(self.messages), np.uint8).reshape(-1, self.size)
        return np.ascontiguousarray(whole[:, place : place + size]).view(order + kind)


def read_ros_table(path: Path) -> FileColumns:
    """Position, velocity and effort of each joint as columns, in the order of the first message.

    The type's definition is ours, not the file's. Joints are taken as revolute: a message does not say.

    Args:
        path: MCAP or SQLite file, or the folder of a recording that lies in several.

    Raises:
        InputError: it is too large, or holds no joint states with an effort.
    """
    found = _joint_states(path)
    if not found:
        raise InputError(f"{path}: no messages of type {_TYPE}")
    topics = list(dict.fromkeys(one.topic for one in found))
    topic = max(
        topics,
        key=lambda name: sum(
            len(one.messages) for one in found if one.topic == name and "torque" in one.places
        ),
    )
    alike = _of_one_set([one for one in found if one.topic == topic])
    joints = alike[0].joints
    columns: dict[str, Any] = {"time_s": _times(alike)}
    for what, called in _ARRAYS.items():
        if all(what in one.places for one in alike):
            values = np.concatenate([_in_order(one, what, joints) for one in alike])
            if np.isfinite(values).all():
                columns |= {called.format(i + 1): values[:, i] for i in range(len(joints))}
    if "torque_1_Nm" not in columns:
        raise InputError(f"{path}: topic '{topic}' {_why_no_effort(alike)}")
    if len(columns["time_s"]) > 1 and not np.any(columns["time_s"]):
        raise InputError(
            f"{path}: topic '{topic}': every message has the same header.stamp; let the driver set it"
        )
    order = np.unique(columns["time_s"], return_index=True)[1]
    table = pa.table({name: values[order] for name, values in columns.items()})
    named = ", ".join(f"{i} '{name}'" for i, name in enumerate(joints[:8], 1))
    return FileColumns(
        table, ".", (f"topic '{topic}' of {len(topics)}", f"joints {named}, taken as revolute")
    )


def _why_no_effort(alike: Sequence[_Alike]) -> str:
    """What is wrong with the effort: it lacks, or has numbers that are none."""
    total = sum(len(one.messages) for one in alike)
    lacking = sum(len(one.messages) for one in alike if "torque" not in one.places)
    if lacking:
        share = f" in {lacking} of {total} messages" if lacking < total else ""
        return f"has no effort{share}, which is what a model explains"
    joints = alike[0].joints
    spoilt = ~np.isfinite(np.concatenate([_in_order(one, "torque", joints) for one in alike]))
    joint = int(np.argmax(spoilt.any(axis=0)))
    return f"has no finite effort of joint '{joints[joint]}' in {spoilt[:, joint].sum()} of {total} messages"


def _joint_states(path: Path) -> list[_Alike]:
    """The joint states of all topics. InputError: hardly any two of them are alike."""
    found: list[_Alike] = []
    for topic, message in messages_of(path, _TYPE):
        try:
            one = next((one for one in found if one.topic == topic and one.takes(message)), None)
            one = one or _parsed(topic, message)
        except (struct.error, TypeError, IndexError) as error:
            raise InputError(f"{path}: a message of topic '{topic}' is cut off, or no {_TYPE}") from error
        if not one.messages:
            found.append(one)
        one.messages.append(message)
        if len(found) > _MOST_KINDS:
            raise InputError(f"{path}: its messages name more than {_MOST_KINDS} sets of joints")
    return found


def _parsed(topic: str, message: bytes) -> _Alike:
    """Where what stands in a message: CDR of the OMG, in which a number begins at a multiple of its size.

    Raises:
        struct.error: it ends too soon.
    """
    order = "<" if message[1] & 1 else ">"
    place = _CDR_BYTES + _STAMP_BYTES

    def count() -> int:
        nonlocal place
        place += -(place - _CDR_BYTES) % 4 + 4
        return int(struct.unpack_from(order + "I", message, place - 4)[0])

    def text() -> str:
        nonlocal place
        size = count()
        (found,) = struct.unpack_from(f"{size}s", message, place)
        place += size
        return str(found.rstrip(b"\0"), errors="replace")

    text()  # of the frame
    joints, places = [text() for _ in range(count())], {}
    named = place
    for what in _ARRAYS:
        size = count()
        place += -(place - _CDR_BYTES) % 8 if size else 0
        struct.unpack_from(f"{8 * size}x", message, place)
        if size and size == len(joints):
            places[what] = place
        place += 8 * size
    head = message[_CDR_BYTES + _STAMP_BYTES : named]
    return _Alike(topic, tuple(joints), message[:_CDR_BYTES], head, len(message), places)


def _of_one_set(found: Sequence[_Alike]) -> list[_Alike]:
    """Those with the most usual joints: a gripper may speak on the same topic."""
    sets = Counter[frozenset[str]]()
    for one in found:
        sets[frozenset(one.joints)] += len(one.messages)
    usual = sets.most_common(1)[0][0]
    return [one for one in found if frozenset(one.joints) == usual]


def _times(alike: Sequence[_Alike]) -> FloatArray:
    """Time since the first stamp [s]: nanoseconds since 1970 need more digits than a float has."""
    stamps = []
    for one in alike:
        seconds, nanos = one.numbers("i4", _CDR_BYTES, 1), one.numbers("u4", _CDR_BYTES + 4, 1)
        stamps.append(seconds[:, 0].astype(np.int64) * _NANO + nanos[:, 0])
    whole = np.concatenate(stamps)
    return np.asarray((whole - whole.min()) / _NANO)


def _in_order(one: _Alike, what: str, joints: Sequence[str]) -> FloatArray:
    """One of their arrays (messages, joints), joints in the order given."""
    places = [one.joints.index(name) for name in joints]
    found = one.numbers("f8", one.places[what], len(joints))
    return np.array(found[:, places], dtype=np.float64)
