"""Read joint states of ROS 2 bags (MCAP or SQLite) from one file or a folder."""

import sqlite3
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from numpy.typing import NDArray

from palpate.estimation.data.file_columns import BAGS, FileColumns, check_size, natural_key
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

_MAX_MESSAGE_BYTES = 1 << 20


def _messages(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield topic and bytes of each joint state, from one file or the files of a folder."""
    parts = [part for part in path.iterdir() if part.suffix in BAGS] if path.is_dir() else [path]
    for part in sorted(parts, key=natural_key):
        if part.suffix == ".db3":
            check_size(part, part.stat().st_size)
            journal = part.with_name(part.name + "-wal")
            if journal.is_file() and journal.stat().st_size > 0:  # reading its messages would modify the bag
                raise InputError(
                    f"{part}: messages are still in {journal.name}; end the recording, or join them with: "
                    f"sqlite3 {part.name} 'PRAGMA wal_checkpoint(TRUNCATE)'"
                )
            read_only = f"{part.resolve().as_uri()}?mode=ro&immutable=1"
            with closing(sqlite3.connect(read_only, uri=True)) as database:
                database.execute("PRAGMA trusted_schema=OFF")
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_MESSAGE_BYTES)
                # Read tables only: a view in an untrusted file may never end.
                rows = database.execute("SELECT name FROM sqlite_schema WHERE type='table'")
                if not {"topics", "messages"} <= {name for (name,) in rows}:
                    raise InputError(
                        f"{part}: is not a ROS 2 recording: it lacks the tables 'topics' and 'messages'"
                    )
                yield from database.execute(
                    "SELECT name, data FROM messages JOIN topics ON topic_id = topics.id "
                    "WHERE type = ? ORDER BY timestamp",
                    (_TYPE,),
                )
            continue
        schemas: dict[int, str] = {}
        topics: dict[int, str] = {}
        for record in _records(part):
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel) and schemas.get(record.schema_id) == _TYPE:
                topics[record.id] = record.topic
            elif isinstance(record, Message) and record.channel_id in topics:
                yield topics[record.channel_id], record.data


def _records(path: Path) -> Iterator[Any]:
    """Yield all records of an MCAP file; the unpacked size of its chunks is bounded."""
    size = 0
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            size += record.uncompressed_size
            check_size(path, size)
            # The data must not exceed the size stated in the header.
            most, data = record.uncompressed_size, record.data
            if record.compression == "lz4":
                data = LZ4FrameDecompressor().decompress(data, max_length=most)
            elif record.compression == "zstd":
                if zstandard.frame_content_size(data) > most:
                    raise InputError("a chunk is larger than its header states")
                data = zstandard.ZstdDecompressor().decompress(data, max_output_size=most)
            record.data, record.compression = data, ""
            yield from breakup_chunk(record)


_TYPE = "sensor_msgs/msg/JointState"
_ARRAYS = {"position": "position_{}_rad", "velocity": "velocity_{}_rad_s", "torque": "torque_{}_Nm"}
_CDR_BYTES = 4  # header before the first field; it states the byte order
_STAMP_BYTES = 8  # seconds and nanoseconds
_NANO = 10**9
_MAX_LAYOUTS = 1000


@dataclass(frozen=True)
class _MessageGroup:
    """Messages of one topic with the same layout."""

    topic: str
    joints: tuple[str, ...]
    begins: bytes  # header of the message, which states the byte order
    text: bytes  # names of the frame and the joints, as encoded after the time stamp
    size: int  # size of each message [bytes]
    places: dict[str, int]  # first byte of each array that has a number for each joint
    messages: list[bytes] = field(default_factory=list)

    def accepts(self, message: bytes) -> bool:
        """Return whether a message has this layout."""
        same_size = len(message) == self.size and message.startswith(self.begins)
        return same_size and message.startswith(self.text, _CDR_BYTES + _STAMP_BYTES)

    def numbers(self, kind: str, place: int, count: int) -> NDArray[Any]:
        """Read numbers that start at the same byte of each message, shape (messages, count).

        Args:
            kind: numpy type of a number without its byte order, which the messages state, such as "f8".
            place: first byte of the numbers in a message.
            count: how many numbers each message has there.
        """
        size = np.dtype(kind).itemsize * count
        order = "<" if self.begins[1] & 1 else ">"
        matrix = np.frombuffer(b"".join(self.messages), np.uint8).reshape(-1, self.size)
        return np.ascontiguousarray(matrix[:, place : place + size]).view(order + kind)


def read_ros_table(path: Path) -> FileColumns:
    """Read position, velocity and effort of each joint as columns, in the order of the first message.

    The message layout is built in and not read from the file. Joints are treated as revolute, since a message
    does not state their type.

    Args:
        path: MCAP or SQLite file, or the folder of a recording in several files.

    Raises:
        InputError: the recording is too large, or has no joint states with an effort.
    """
    groups = _joint_states(path)
    if not groups:
        raise InputError(
            f"{path}: holds no messages of type {_TYPE}, the only type that is read; write other messages, "
            "such as wrenches, with time and motion to a CSV file"
        )
    with_torque = dict.fromkeys((group.topic for group in groups), 0)
    for group in groups:
        with_torque[group.topic] += len(group.messages) * ("torque" in group.places)
    topic = max(with_torque, key=with_torque.__getitem__)
    groups_of_topic = [group for group in groups if group.topic == topic]
    sets = Counter[frozenset[str]]()
    for group in groups_of_topic:  # keep the most frequent set of joints: a gripper may use the same topic
        sets[frozenset(group.joints)] += len(group.messages)
    usual = sets.most_common(1)[0][0]
    groups_of_topic = [group for group in groups_of_topic if frozenset(group.joints) == usual]
    joints = groups_of_topic[0].joints
    stamps = []
    for group in groups_of_topic:
        seconds, nanos = group.numbers("i4", _CDR_BYTES, 1), group.numbers("u4", _CDR_BYTES + 4, 1)
        stamps.append(seconds[:, 0].astype(np.int64) * _NANO + nanos[:, 0])
    # Times are relative to the first stamp: nanoseconds since 1970 exceed the precision of a float.
    time_ns = np.concatenate(stamps)
    columns: dict[str, Any] = {"time_s": (time_ns - time_ns.min()) / _NANO}
    for what, pattern in _ARRAYS.items():
        if all(what in group.places for group in groups_of_topic):
            values = np.concatenate([_in_order(group, what, joints) for group in groups_of_topic])
            if np.isfinite(values).all():
                columns |= {pattern.format(i + 1): values[:, i] for i in range(len(joints))}
    if "torque_1_Nm" not in columns:
        total = sum(len(group.messages) for group in groups_of_topic)
        lacking = sum(len(group.messages) for group in groups_of_topic if "torque" not in group.places)
        if lacking:
            share = f" in {lacking} of {total} messages" if lacking < total else ""
            reason = f"has no effort{share}, which every model needs"
        else:
            efforts = [_in_order(group, "torque", joints) for group in groups_of_topic]
            invalid = np.sum(~np.isfinite(np.concatenate(efforts)), axis=0)
            joint = int(np.argmax(invalid > 0))
            reason = (
                f"has no finite effort of joint '{joints[joint]}' in {invalid[joint]} of {total} messages"
            )
        raise InputError(f"{path}: topic '{topic}' {reason}")
    if len(columns["time_s"]) > 1 and not np.any(columns["time_s"]):
        raise InputError(
            f"{path}: topic '{topic}': every message has the same header.stamp; configure the driver to "
            "stamp each message"
        )
    order = np.unique(columns["time_s"], return_index=True)[1]
    table = pa.table({name: values[order] for name, values in columns.items()})
    named = ", ".join(f"{i} '{name}'" for i, name in enumerate(joints[:8], 1))
    notes = (f"topic '{topic}' of {len(with_torque)}", f"joints {named}, taken as revolute")
    return FileColumns(table, notes=notes)


def _joint_states(path: Path) -> list[_MessageGroup]:
    """Group the joint states of all topics by layout."""
    groups: list[_MessageGroup] = []
    for topic, message in _messages(path):
        try:
            group = next((group for group in groups if group.topic == topic and group.accepts(message)), None)
            group = group or _parse_layout(topic, message)
        except (struct.error, TypeError, IndexError) as error:
            raise InputError(
                f"{path}: a message of topic '{topic}' is cut off or is not a {_TYPE}"
            ) from error
        if not group.messages:
            groups.append(group)
        group.messages.append(message)
        if len(groups) > _MAX_LAYOUTS:
            raise InputError(f"{path}: its messages use over {_MAX_LAYOUTS} different sets of joint names")
    return groups


def _parse_layout(topic: str, message: bytes) -> _MessageGroup:
    """Locate the arrays in a message (OMG CDR: a number begins at a multiple of its size)."""
    order = "<" if message[1] & 1 else ">"
    place = _CDR_BYTES + _STAMP_BYTES

    def count() -> int:
        nonlocal place
        place += -(place - _CDR_BYTES) % 4 + 4
        return int(struct.unpack_from(order + "I", message, place - 4)[0])

    def text() -> str:
        nonlocal place
        size = count()
        (text,) = struct.unpack_from(f"{size}s", message, place)
        place += size
        return str(text.rstrip(b"\0"), errors="replace")

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
    return _MessageGroup(topic, tuple(joints), message[:_CDR_BYTES], head, len(message), places)


def _in_order(group: _MessageGroup, what: str, joints: Sequence[str]) -> FloatArray:
    """Return one array of a group with the joints in a given order, shape (messages, joints)."""
    places = [group.joints.index(name) for name in joints]
    numbers = group.numbers("f8", group.places[what], len(joints))
    return np.array(numbers[:, places], dtype=np.float64)
