"""A session written at its end by this process, for tests of measurements rather than of the log."""

from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from palpate.robot_io.session import Event, SessionMetadata, Stream, write_session
from palpate.robot_io.session.writer import new_session_path


class LogInProcess:
    """Stands for `SessionWriter`, which starts a process of its own."""

    dropped, failure = 0, None

    def __init__(
        self, path: Path, streams: list[Stream], metadata: SessionMetadata, *, wait_for_room: bool = False
    ) -> None:
        self._path, self._metadata = new_session_path(path), metadata
        self._streams = {stream.name: stream for stream in streams}
        self._records: dict[str, list[tuple[object, ...]]] = {name: [] for name in self._streams}
        self._events: list[Event] = []
        self._closed = False

    def append(self, stream: str, record: tuple[object, ...]) -> None:
        self._records[stream].append(record)

    def event(self, time_s: float, kind: str, text: str, data: object = None) -> None:
        self._events.append(Event(time_s, kind, text, data))

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        tables = []
        for name, stream in self._streams.items():
            records = np.array(self._records[name], stream.dtype)
            tables.append((stream, {column.name: records[column.name] for column in stream.columns}))
        write_session(self._path, tables, self._metadata, self._events)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _type: type, _error: BaseException, _traceback: TracebackType) -> None:
        self.close()
