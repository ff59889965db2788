"""Log of a live session. The control loop only copies to memory; another process writes to the disk."""

import os
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.robot_io.errors import InputError, SessionError, UnknownNameError, UnloggedError
from palpate.robot_io.files.atomic_write import atomic_write
from palpate.robot_io.session.event import EVENT_STREAM, Event, SessionMetadata, encode_event
from palpate.robot_io.session.mcap_file import McapFile
from palpate.robot_io.session.shared_log import (
    FINISHED,
    STARTING,
    SharedLog,
    WriterJob,
    check_streams,
    is_locked,
    open_memory,
)
from palpate.robot_io.session.stream import MAX_RECORD_BYTES, TIME_COLUMN, Record, Stream, streams_to_json

START_LIMIT_S = 60.0
_AT_ONCE = 16_384  # records that are written at once, to bound memory
_MANY = 500_000  # records of a stream beyond which a message holds several, because each message takes 6 us
_BATCH = 100  # records in such a message, if they fit
STALL_LIMIT_S = 30.0  # longest wait without a single record reaching the disk
_STALLED = f"the disk accepted no data for {STALL_LIMIT_S:.0f} s"
_KILL_LIMIT_S = 2.0
_POLL_S = 0.002


class SessionWriter:
    """Writes records and events of one session, for one thread of one program.

    Args:
        ring_slots: records that each stream's ring holds while the disk is slow.
        wait_for_room: let `append` wait when the ring is full instead of dropping. For simulated time, which
            stands still meanwhile; never for a real robot.

    Raises:
        InputError: the streams cannot be in one session.
        SessionError: the file already exists or cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        streams: Sequence[Stream],
        metadata: SessionMetadata,
        *,
        ring_slots: int = 8192,
        wait_for_room: bool = False,
    ) -> None:
        check_streams(streams)
        streams = [replace(stream, batch=1) for stream in streams]  # none waits in memory for others
        if ring_slots < 1:
            raise InputError(f"ring_slots {ring_slots}: must be at least 1")
        self.path = new_session_path(path)
        self._wait_for_room = wait_for_room
        self._patience_s = STALL_LIMIT_S
        self._closed = False
        memory = open_memory(streams, ring_slots)
        try:
            self._log = SharedLog(memory, streams, ring_slots)
            job = WriterJob(
                path=str(self.path.absolute()),
                memory=memory,
                streams=streams_to_json(tuple(streams)),
                ring_slots=ring_slots,
                parent_pid=os.getpid(),
                metadata=metadata.to_strings(),
                extra=dict(metadata.extra),
            )
            self._process = job.start()
        finally:
            os.close(memory)
        self._rings = dict(self._log.rings)
        give_up_s = time.monotonic() + START_LIMIT_S
        while self._log.state == STARTING and self._process.poll() is None:
            if time.monotonic() > give_up_s:
                self._process.kill()
            time.sleep(_POLL_S)
        if self.failure is not None:
            self._closed = True
            self._process.wait()
            if isinstance(self._log.system_error, FileExistsError):  # another program was faster
                raise _exists(self.path)
            raise SessionError(f"{self.path} cannot be written: {self.failure}") from self._log.system_error

    def append(self, stream_name: str, record: Record) -> None:
        """Log one record; this takes microseconds, even if the disk is slow.

        If the ring is full it is dropped and counted. A record is a tuple with one value for each column, or
        an np.void of the stream's dtype.

        Args:
            stream_name: name of the stream.
            record: a value for each column, in their order.

        Raises:
            InputError: there is no such stream, or the session is closed.
            TypeError, ValueError: the record does not have the stream's form.
        """
        ring = self._rings.get(stream_name)
        if ring is None:
            if self._closed:
                raise InputError(f"the session {self.path} is closed")
            valid = ", ".join(name for name in self._rings if name != EVENT_STREAM)
            raise UnknownNameError(f"no stream is called '{stream_name}'. Valid: {valid}")
        if self._wait_for_room and ring.full:
            give_up_s = time.monotonic() + STALL_LIMIT_S
            while ring.full and self._process.poll() is None:
                if time.monotonic() > give_up_s:
                    self._wait_for_room = False  # from now on, records are dropped and counted
                    self._patience_s = _KILL_LIMIT_S  # it has been waited for once
                    raise UnloggedError(f"{self.path}: {_STALLED}")
                time.sleep(_POLL_S)
        ring.push(record)

    def event(self, time_s: float, kind: str, text: str, data: Mapping[str, Any] | None = None) -> None:
        """Log one event; see `Event`. Like `append`, this does not wait.

        An event is truncated to 4000 bytes, data included. InputError: the session is closed.

        Args:
            time_s: time of the event, session's clock [s].
            kind: short word.
            text: one line for people.
            data: values for programs.
        """
        message = encode_event(Event(time_s, kind, text, data))
        self.append(EVENT_STREAM, (time_s, len(message), message))

    @property
    def dropped(self) -> int:
        """Number of records and events dropped so far because their ring was full."""
        return sum(ring.dropped for ring in self._log.rings.values())

    @property
    def failure(self) -> str | None:
        """Reason why records no longer reach the disk; None while they do."""
        if self._log.failure is not None:
            return self._log.failure
        if self._log.state != FINISHED and self._process.poll() is not None:
            return f"the writer process ended with {self._process.returncode}"
        return None

    def close(self) -> None:
        """Empty the rings, finish the file, wait for it; raise `UnloggedError` if data are missing."""
        if self._closed:
            return
        self._closed = True
        self._rings = {}
        self._log.request_stop()
        taken: int | None = None
        while self._process.poll() is None:
            now_taken = sum(ring.taken for ring in self._log.rings.values())
            if now_taken != taken:
                taken, give_up_s = now_taken, time.monotonic() + self._patience_s
            if time.monotonic() > give_up_s:  # it has written nothing for too long
                self._process.kill()
                with suppress(subprocess.TimeoutExpired):  # nothing ends a process that a disk holds
                    self._process.wait(_KILL_LIMIT_S)
                raise UnloggedError(f"{self.path}: {_STALLED}; the end is missing")
            time.sleep(_POLL_S)
        self._process.wait()
        if self.failure is not None:
            raise UnloggedError(f"{self.path} is not complete: {self.failure}") from self._log.system_error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except SessionError as failure:
            if error is None:
                raise
            # The error in the `with` block came first, so it is the one that is raised
            error.add_note(str(failure))


def new_session_path(path: str | os.PathLike[str]) -> Path:
    """Return the path of a new file, with its folder made, or raise `SessionError`.

    Args:
        path: path of the session that is to be written.
    """
    new = Path(path)
    try:
        if new.exists():
            raise _exists(new)
        new.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SessionError(f"{new} cannot be written: {error.strerror}") from error
    return new


def _exists(path: Path) -> SessionError:
    if is_locked(path):
        return SessionError(f"{path} is being written by another program at this moment; choose another name")
    return SessionError(f"{path} already exists; a session is never changed")


def write_session(
    path: str | os.PathLike[str],
    streams: Sequence[tuple[Stream, Mapping[str, ArrayLike]]],
    metadata: SessionMetadata,
    events: Iterable[Event] = (),
    progress: Callable[[float], None] = lambda share: None,
) -> Path:
    """Write a whole session at once; the file appears under its name only when it is complete.

    Args:
        path: the new session file; missing folders above it are made.
        streams: each with its columns, shape (n,) or (n, width).
        metadata: origin of the session.
        events: events in the order of their times.
        progress: called with the share of the records that is written, 0 to 1.

    Raises:
        InputError: the arrays do not fit their streams.
        SessionError: the file already exists or cannot be written.
    """
    check_streams([stream for stream, _ in streams])
    tables: list[_Table] = []
    for stream, given in streams:
        columns = stream.arrays(given)
        # A long stream has as many records in a message as fit.
        most = min(_BATCH, MAX_RECORD_BYTES // stream.dtype.itemsize)
        tables.append((replace(stream, batch=most if len(columns[TIME_COLUMN]) > _MANY else 1), columns))
    new = new_session_path(path)
    try:
        with atomic_write(new, replace=False) as unfinished, unfinished.open("wb") as file:
            mcap = McapFile(file, [stream for stream, _ in tables], metadata)
            listed = tuple(events)
            mcap.write_events(
                range(len(listed)), [event.time_s for event in listed], list(map(encode_event, listed))
            )
            counts = {stream.name: len(arrays[TIME_COLUMN]) for stream, arrays in tables}
            written = 0
            for stream, arrays in tables:
                step = _AT_ONCE // stream.batch * stream.batch
                for start in range(0, counts[stream.name], step):
                    piece = {name: array[start : start + step] for name, array in arrays.items()}
                    part = stream.records(piece)
                    numbers = np.arange(start, start + len(part), dtype=np.uint64)
                    mcap.write_records(stream.name, numbers, part)
                    written += len(part)
                    progress(written / sum(counts.values()))
            mcap.finish({EVENT_STREAM: len(listed)} | counts)
            os.fsync(file.fileno())
    except FileExistsError:
        raise _exists(new) from None
    except OSError as error:
        raise SessionError(f"{new} cannot be written: {error.strerror}") from error
    return new


_Table = tuple[Stream, Mapping[str, NDArray[Any]]]
