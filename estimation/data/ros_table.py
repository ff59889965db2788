"""Joint states of ROS 2, as rosbag2 writes them: MCAP or SQLite, in one file or in the files of a folder."""

import sqlite3
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_ros2.decoder import DecoderFactory

from estimation.data.file_columns import BAGS, FileColumns, check_size, counted
from robot_io.errors import InputError
from robot_io.types import FloatArray

_TYPE = "sensor_msgs/msg/JointState"
_DEFINITION = b"""std_msgs/Header header
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
uint32 nanosec
"""
_COLUMNS = {"position": "position_{}_rad", "velocity": "velocity_{}_rad_s", "effort": "torque_{}_Nm"}
_NANO = 10**9
_MOST_MESSAGE_BYTES = 1 << 20


def read_ros_table(path: Path) -> FileColumns:
    """Position, velocity and effort of each joint as columns, in the order of the first message.

    The type's definition is ours, not the file's. Joints are taken as revolute: a message does not say.

    Args:
        path: MCAP or SQLite file, or the folder of a recording that lies in several.

    Raises:
        InputError: it is too large, or holds no joint states with an effort.
    """
    topics = _joint_states(path)
    if not topics:
        raise InputError(f"{path}: no messages of type {_TYPE}")
    topic = max(topics, key=lambda name: sum(len(state.effort) > 0 for state in topics[name]))
    states = _of_one_set(topics[topic])
    names = list(states[0].name)
    columns: dict[str, Any] = {"time_s": _times(states)}
    for what, called in _COLUMNS.items():
        values = _values(states, names, what)
        columns |= {called.format(i + 1): values[:, i] for i in range(len(names)) if len(values)}
    if "torque_1_Nm" not in columns:
        raise InputError(f"{path}: topic '{topic}' has no effort, which is what a model explains")
    order = np.unique(columns["time_s"], return_index=True)[1]
    table = pa.table({name: values[order] for name, values in columns.items()})
    joints = ", ".join(f"{i} '{name}'" for i, name in enumerate(names[:8], 1))
    return FileColumns(
        table, ".", (f"topic '{topic}' of {len(topics)}", f"joints {joints}, taken as revolute")
    )


def _joint_states(path: Path) -> dict[str, list[Any]]:
    """The joint states by topic."""
    decode = DecoderFactory().decoder_for(
        MessageEncoding.CDR, Schema(id=1, name=_TYPE, encoding=SchemaEncoding.ROS2, data=_DEFINITION)
    )
    found: dict[str, list[Any]] = defaultdict(list)
    parts = [part for part in path.iterdir() if part.suffix in BAGS] if path.is_dir() else [path]
    for part in sorted(parts, key=counted):
        for topic, message in (_of_sqlite if part.suffix == ".db3" else _of_mcap)(part):
            if decode is not None:
                found[topic].append(decode(message))
    return found


def _of_sqlite(path: Path) -> Iterator[tuple[str, bytes]]:
    """Topic and bytes of each joint state. Only tables are read: a view of a stranger's may never end."""
    check_size(path, path.stat().st_size)
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        database.execute("PRAGMA trusted_schema=OFF")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_MESSAGE_BYTES)
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_schema WHERE type='table'")}
        if not {"topics", "messages"} <= tables:
            raise InputError(f"{path}: is no recording of ROS 2: it has no tables 'topics' and 'messages'")
        yield from database.execute(
            "SELECT name, data FROM messages JOIN topics ON topic_id = topics.id "
            "WHERE type = ? ORDER BY timestamp",
            (_TYPE,),
        )


def _of_mcap(path: Path) -> Iterator[tuple[str, bytes]]:
    """Topic and bytes of each joint state."""
    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    for record in _records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel) and schemas.get(record.schema_id) == _TYPE:
            topics[record.id] = record.topic
        elif isinstance(record, Message) and record.channel_id in topics:
            yield topics[record.channel_id], record.data


def _records(path: Path) -> Iterator[Any]:
    """All records, with those in chunks that unpack to a bounded size."""
    size = 0
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            size += record.uncompressed_size
            check_size(path, size)
            yield from breakup_chunk(_unpacked(record))


def _unpacked(chunk: Chunk) -> Chunk:
    """The same chunk, whose data take no more than it says."""
    size, data = chunk.uncompressed_size, chunk.data
    if chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(data, max_length=size)
    elif chunk.compression == "zstd":
        if zstandard.frame_content_size(data) > size:
            raise InputError("a chunk holds more than it says")
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    chunk.data, chunk.compression = data, ""
    return chunk


def _of_one_set(states: Sequence[Any]) -> list[Any]:
    """The messages with the most usual joints: a gripper may speak on the same topic."""
    sets = Counter(frozenset(state.name) for state in states)
    usual = sets.most_common(1)[0][0]
    return [state for state in states if frozenset(state.name) == usual]


def _times(states: Sequence[Any]) -> FloatArray:
    """Time since the first stamp [s]: nanoseconds since 1970 need more digits than a float has."""
    stamps = [state.header.stamp.sec * _NANO + state.header.stamp.nanosec for state in states]
    first = min(stamps)
    return np.array([stamp - first for stamp in stamps], dtype=np.float64) / _NANO


def _values(states: Sequence[Any], names: Sequence[str], what: str) -> FloatArray:
    """One array (n, joints), joints in the order of `names`; empty where a message does not have them all."""
    rows = []
    for state in states:
        values = getattr(state, what)
        if len(values) != len(names):
            return np.zeros((0, len(names)))
        place = {name: i for i, name in enumerate(state.name)}
        rows.append([values[place[name]] for name in names])
    found = np.array(rows, dtype=np.float64)
    return found if np.isfinite(found).all() else np.zeros((0, len(names)))
