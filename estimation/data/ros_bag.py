"""Messages of ROS 2, as rosbag2 stores them: MCAP or SQLite, in one file or in the files of a folder."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from estimation.data.file_columns import BAGS, check_size, counted
from robot_io.errors import InputError

_MOST_MESSAGE_BYTES = 1 << 20


def messages_of(path: Path, kind: str) -> Iterator[tuple[str, bytes]]:
    """Topic and bytes of each message of a type, from one file or the files of a folder.

    Raises:
        InputError: it holds too much, or is no such recording.
    """
    parts = [part for part in path.iterdir() if part.suffix in BAGS] if path.is_dir() else [path]
    for part in sorted(parts, key=counted):
        yield from (_of_sqlite if part.suffix == ".db3" else _of_mcap)(part, kind)


def _of_sqlite(path: Path, kind: str) -> Iterator[tuple[str, bytes]]:
    """Those of a database. Only tables are read: a view of a stranger's may never end."""
    check_size(path, path.stat().st_size)
    _check_is_whole(path)
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        database.execute("PRAGMA trusted_schema=OFF")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_MESSAGE_BYTES)
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_schema WHERE type='table'")}
        if not {"topics", "messages"} <= tables:
            raise InputError(f"{path}: is no recording of ROS 2: it has no tables 'topics' and 'messages'")
        yield from database.execute(
            "SELECT name, data FROM messages JOIN topics ON topic_id = topics.id "
            "WHERE type = ? ORDER BY timestamp",
            (kind,),
        )


def _check_is_whole(path: Path) -> None:
    """Refuse a database whose last messages are in a file beside it: reading that would write."""
    beside = path.with_name(path.name + "-wal")
    if beside.is_file() and beside.stat().st_size > 0:
        raise InputError(
            f"{path}: messages are still in {beside.name}; end the recording, or join them with: "
            f"sqlite3 {path.name} 'PRAGMA wal_checkpoint(TRUNCATE)'"
        )


def _of_mcap(path: Path, kind: str) -> Iterator[tuple[str, bytes]]:
    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    for record in _records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel) and schemas.get(record.schema_id) == kind:
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
