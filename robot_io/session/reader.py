"""Reads a session file, whole or cut off by a crash, into arrays."""

import os
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robot_io.errors import InputError, SessionError, UnknownNameError
from robot_io.session.event import EVENT_STREAM, Event, decode_event, says_unclosed
from robot_io.session.mcap_file import END_RECORD, EXTRA_RECORD, FORMAT_VERSIONS, HEADER_RECORD
from robot_io.session.metadata import SessionMetadata
from robot_io.session.samples import Samples
from robot_io.session.scan import Growing, Scan, scan
from robot_io.session.shared_log import check_streams
from robot_io.session.stream import Stream, streams_from_json
from robot_io.session.wire import WireFormat

MAX_FILE_BYTES = 4 * 1024**3


@dataclass(frozen=True, eq=False)
class Session:
    """What happened in one session."""

    path: Path  # the session file
    metadata: SessionMetadata  # where the session comes from
    events: tuple[Event, ...]  # in the order in which they were logged
    # True if the file was never finished, or still is being written; what is here is all that reached the
    # disk in whole chunks.
    truncated: bool
    dropped: int  # records and events that are missing because the disk was too slow
    _samples: Mapping[str, Samples]

    @property
    def unclosed(self) -> bool:
        """Whether its program ended without closing it: all is here that was logged until then."""
        return any(map(says_unclosed, self.events))

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "Session":
        """Read a session file.

        SessionError: the file cannot be read, is no session, or was damaged after it was finished.
        """
        place = Path(path)
        try:
            return cls._from_scan(place, scan(_read(place)))
        except SessionError as error:
            raise SessionError(f"{place}: {error}") from error

    @classmethod
    def _from_scan(cls, path: Path, found: Scan) -> "Session":
        header = found.metadata.get(HEADER_RECORD)
        if header is None:
            raise SessionError("no session of palpate, or cut off at its very beginning")
        if header.get("format_version") not in FORMAT_VERSIONS:
            version = header.get("format_version", "")[:20]
            raise SessionError(f"format version '{version}'; this palpate reads {', '.join(FORMAT_VERSIONS)}")
        samples = {one.name: _samples(one, found.messages.get(one.name, [])) for one in _streams(header)}
        dropped = sum(_dropped(found, name, len(one), one.stream.batch) for name, one in samples.items())
        return cls(
            path=path,
            metadata=SessionMetadata.from_strings(header, found.metadata.get(EXTRA_RECORD, {})),
            events=tuple(decode_event(message) for message in found.messages.get(EVENT_STREAM, [])),
            truncated=not found.complete,
            dropped=dropped + _dropped(found, EVENT_STREAM, len(found.messages.get(EVENT_STREAM, []))),
            _samples=samples,
        )

    @property
    def stream_names(self) -> tuple[str, ...]:
        """Names of the streams, also of those without samples."""
        return tuple(self._samples)

    def samples(self, stream_name: str) -> Samples:
        """One stream's samples. InputError: the session has no such stream."""
        if stream_name not in self._samples:
            valid = ", ".join(self._samples) or "none"
            raise UnknownNameError(f"{self.path} has no stream '{stream_name}'. Valid: {valid}")
        return self._samples[stream_name]

    @property
    def derived_dir(self) -> Path:
        """Folder beside the session, of the same name, for what is derived from it; it may not exist yet."""
        return self.path.with_suffix("") if self.path.suffix else self.path.with_suffix(".derived")


class Follower:
    """One stream of a session that is still being written; each time only what came new is read.

    The `last` records are kept, so that a long session does not fill the memory.
    """

    def __init__(self, path: Path, stream_name: str, last: int) -> None:
        self._path, self._name, self._last = path, stream_name, last
        self._file = Growing()
        self._wire: WireFormat | None = None
        self._records: deque[bytes] = deque(maxlen=last)
        self.count = 0  # of records that were read
        self.complete = False  # whether the file was finished

    def read(self) -> Samples | None:
        """The stream's last samples; None as long as there are none.

        SessionError: the file cannot be read, or is damaged.
        """
        try:
            with self._path.open("rb") as file:
                file.seek(self._file.read_bytes)
                found = self._file.more(file.read(MAX_FILE_BYTES))
        except OSError as error:
            raise SessionError(f"{self._path}: cannot be read: {error.strerror}") from error
        new = found.messages.get(self._name, [])
        self._records.extend(new)
        self.count += len(new)
        self.complete = found.complete
        if self._wire is None and HEADER_RECORD in found.metadata:
            streams = {one.name: one for one in _streams(found.metadata[HEADER_RECORD])}
            self._wire = WireFormat(streams[self._name]) if self._name in streams else None
        if self._wire is None or not self._records:
            return None
        return Samples.of(self._wire.stream, self._wire.decode(b"".join(self._records)))


def _read(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise SessionError("no session: it is not a file")
        if size > MAX_FILE_BYTES:
            raise SessionError(f"{size} bytes; at most {MAX_FILE_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise SessionError(f"cannot be read: {error.strerror}") from error


def _streams(header: Mapping[str, str]) -> tuple[Stream, ...]:
    streams = streams_from_json(header.get("streams", ""))
    try:
        check_streams(streams)
    except InputError as error:
        raise SessionError(f"its streams are not valid: {error}") from error
    return streams


def _samples(stream: Stream, messages: list[bytes]) -> Samples:
    return Samples.of(stream, WireFormat(stream).decode(b"".join(messages)))


def _dropped(found: Scan, stream_name: str, count: int, batch: int = 1) -> int:
    """Sequence numbers without a record: in the gaps, and after the last one if the file knows its end."""
    numbers = found.sequence[stream_name]
    in_last = count - (len(numbers) - 1) * batch
    offered = numbers[-1] + in_last if count else 0
    stated = found.metadata.get(END_RECORD, {}).get(stream_name, "")
    if len(stated) < 20 and stated.isdecimal():
        offered = max(offered, int(stated))
    return max(0, offered - count)
