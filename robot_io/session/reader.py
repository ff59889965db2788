"""Reading of a session file, whole or cut off by a crash, into arrays."""

import os
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

from palpate.robot_io.errors import InputError, SessionError, UnknownNameError
from palpate.robot_io.session.event import EVENT_STREAM, UNCLOSED, Event, SessionMetadata, decode_event
from palpate.robot_io.session.mcap_file import (
    END_RECORD,
    EXTRA_RECORD,
    FORMAT_VERSIONS,
    HEADER_RECORD,
    GrowingFile,
    Scan,
    scan,
)
from palpate.robot_io.session.shared_log import check_streams
from palpate.robot_io.session.stream import Samples, Stream, streams_from_json
from palpate.robot_io.session.wire import WireFormat

MAX_FILE_BYTES = 4 * 1024**3


@dataclass(frozen=True, eq=False)
class Session:
    """Content of one session file."""

    path: Path  # the session file
    metadata: SessionMetadata  # where the session comes from
    events: tuple[Event, ...]  # in the order in which they were logged
    # Whether the file was never finished, or is still being written. The session then holds all whole chunks
    # that have reached the disk.
    truncated: bool
    dropped: int  # records and events that are missing because the disk was too slow
    _samples: Mapping[str, Samples]

    @property
    def unclosed(self) -> bool:
        """Whether its program ended without closing it; the session contains everything logged until then."""
        return any((event.kind, event.text) == UNCLOSED for event in self.events)

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "Session":
        """Read a session file; raise `SessionError` if it is unreadable, damaged, or not a session.

        Args:
            path: path of the file.
        """
        place = Path(path)
        try:
            with _open(place) as file:
                return cls._from_scan(place, scan(file, _formats))
        except SessionError as error:
            raise SessionError(f"{place}: {error}") from error
        except OSError as error:
            raise SessionError(f"{place}: cannot be read: {error.strerror}") from error

    @classmethod
    def _from_scan(cls, path: Path, content: Scan) -> "Session":
        header = content.metadata.get(HEADER_RECORD)
        if header is None:
            raise SessionError("not a palpate session, or cut off near its start")
        if header.get("format_version") not in FORMAT_VERSIONS:
            version = header.get("format_version", "")[:20]
            raise SessionError(f"format version '{version}'; supported: {', '.join(FORMAT_VERSIONS)}")
        samples = {stream.name: _samples(stream, content) for stream in _streams(header)}
        events = tuple(map(decode_event, content.messages.get(EVENT_STREAM, [])))
        dropped = [
            _dropped(content, name, len(sample), sample.stream.batch) for name, sample in samples.items()
        ]
        return cls(
            path=path,
            metadata=SessionMetadata.from_strings(header, content.metadata.get(EXTRA_RECORD, {})),
            events=events,
            truncated=not content.complete,
            dropped=sum(dropped) + _dropped(content, EVENT_STREAM, len(events)),
            _samples=samples,
        )

    @property
    def stream_names(self) -> tuple[str, ...]:
        """Names of the streams, including those without samples."""
        return tuple(self._samples)

    def samples(self, stream_name: str) -> Samples:
        """Return one stream's samples; raise `InputError` if there is no such stream.

        Args:
            stream_name: name of the stream.
        """
        if stream_name not in self._samples:
            valid = ", ".join(self._samples) or "none"
            raise UnknownNameError(f"{self.path} has no stream '{stream_name}'. Valid: {valid}")
        return self._samples[stream_name]

    def read_columns(self, stream_name: str, names: Collection[str]) -> "Session":
        """Return the session with only some columns of a stream, which frees the memory of the others.

        Args:
            stream_name: name of the stream; a session without it is returned as it is.
            names: columns to keep, whether they are there or not.
        """
        if stream_name not in self._samples:
            return self
        kept = self._samples[stream_name].select(slice(None), names)
        return replace(self, _samples={**self._samples, stream_name: kept})

    @property
    def derived_dir(self) -> Path:
        """Folder beside the session, of the same name, for derived files; it may not exist yet."""
        return self.path.with_suffix("") if self.path.suffix else self.path.with_suffix(".derived")


class SessionTail:
    """Reads one stream of a session that is still being written; each call reads only what is new.

    Args:
        last: number of records that are kept, so that a long session does not fill the memory.

    Attributes:
        count: number of records that were read.
        complete: whether the file was finished.
    """

    def __init__(self, path: Path, stream_name: str, last: int) -> None:
        self._path, self._name, self._last = path, stream_name, last
        self._file = GrowingFile()
        self._wire: WireFormat | None = None
        self._records: deque[bytes] = deque(maxlen=last)
        self.count = 0
        self.complete = False

    def read(self) -> Samples | None:
        """Return the last samples, None before the first; raise `SessionError` if the file is unreadable."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._file.read_bytes)
                content = self._file.read(file.read(MAX_FILE_BYTES))
        except OSError as error:
            raise SessionError(f"{self._path}: cannot be read: {error.strerror}") from error
        new = content.messages.get(self._name, [])
        self._records.extend(new)
        self.count += len(new)
        self.complete = content.complete
        if self._wire is None and HEADER_RECORD in content.metadata:
            streams = {stream.name: stream for stream in _streams(content.metadata[HEADER_RECORD])}
            self._wire = WireFormat(streams[self._name]) if self._name in streams else None
        if self._wire is None or not self._records:
            return None
        return Samples.of(self._wire.stream, self._wire.decode(b"".join(self._records)))


def _open(path: Path) -> IO[bytes]:
    size = path.stat().st_size
    if not path.is_file():
        raise SessionError("not a session: it is not a file")
    if size > MAX_FILE_BYTES:
        raise SessionError(f"the file has {size} bytes, more than the limit of {MAX_FILE_BYTES}")
    return path.open("rb")


def _formats(header: Mapping[str, str]) -> dict[str, WireFormat]:
    """Return the format of each stream in a header; none if it is invalid, which is reported later."""
    try:
        return {stream.name: WireFormat(stream) for stream in _streams(header)}
    except SessionError:
        return {}


def _streams(header: Mapping[str, str]) -> tuple[Stream, ...]:
    streams = streams_from_json(header.get("streams", ""))
    try:
        check_streams(streams)
    except InputError as error:
        raise SessionError(f"its streams are not valid: {error}") from error
    return streams


def _samples(stream: Stream, content: Scan) -> Samples:
    if stream.name in content.decoded:
        return Samples.of(stream, content.decoded[stream.name].columns())
    return Samples.of(stream, WireFormat(stream).decode(b"".join(content.messages.get(stream.name, []))))


def _dropped(content: Scan, stream_name: str, count: int, batch: int = 1) -> int:
    """Count sequence numbers without a record: in gaps, and after the last one if the file states its end."""
    numbers = content.sequence[stream_name]
    in_last = count - (len(numbers) - 1) * batch
    offered = numbers[-1] + in_last if count else 0
    stated = content.metadata.get(END_RECORD, {}).get(stream_name, "")
    if len(stated) < 20 and stated.isdecimal():
        offered = max(offered, int(stated))
    return max(0, offered - count)
