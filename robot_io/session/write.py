"""Writes a session whose data are all there already, such as one made from imported measurements."""

import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from robot_io.errors import SessionError
from robot_io.session.event import EVENT_STREAM, Event, encode_event
from robot_io.session.mcap_file import McapFile
from robot_io.session.metadata import SessionMetadata
from robot_io.session.shared_log import check_streams
from robot_io.session.stream import RecordArray, Stream
from robot_io.session.writer import new_session_path


def write_session(
    path: str | os.PathLike[str],
    streams: Sequence[tuple[Stream, Mapping[str, ArrayLike]]],
    metadata: SessionMetadata,
    events: Iterable[Event] = (),
) -> Path:
    """Write a whole session at once; the file appears under its name only when it is complete.

    Args:
        path: the new session file; folders above it are made.
        streams: each stream with its columns, shape (n,) or (n, width).
        metadata: where the session comes from.
        events: in the order in which they happened.

    Returns:
        The path.

    Raises:
        InputError: the arrays do not fit their streams.
        SessionError: the file exists already or cannot be written.
    """
    check_streams([stream for stream, _ in streams])
    records = {stream.name: stream.records(columns) for stream, columns in streams}
    new = new_session_path(path)
    unfinished = new.with_name(f".{new.name}.{os.getpid()}.unfinished")
    try:
        with unfinished.open("wb") as file:
            _write_all(McapFile(file, [stream for stream, _ in streams], metadata), records, tuple(events))
            os.fsync(file.fileno())
        unfinished.replace(new)
    except OSError as error:
        raise SessionError(f"{new} cannot be written: {error.strerror}") from error
    finally:
        with suppress(OSError):
            unfinished.unlink()
    return new


def _write_all(mcap: McapFile, records: Mapping[str, RecordArray], events: Sequence[Event]) -> None:
    messages = [encode_event(event) for event in events]
    mcap.write_events(range(len(events)), [event.time_s for event in events], messages)
    for name, array in records.items():
        mcap.write_records(name, np.arange(len(array), dtype=np.uint64), array)
    mcap.finish({EVENT_STREAM: len(events)} | {name: len(array) for name, array in records.items()})
