"""Where the loop leaves its records: a session's writer, or a few lines in a test."""

from collections.abc import Mapping
from typing import Protocol


class TickLog(Protocol):
    """The part of a session's writer that the loop needs; neither call may block."""

    @property
    def dropped(self) -> int:
        """Records that found no room and are lost."""

    @property
    def failure(self) -> str | None:
        """Why records no longer reach the disk; None while all is well."""

    def append(self, stream_name: str, record: tuple[object, ...]) -> object:
        """Take over one record, a value for each column of the stream."""

    def event(self, time_s: float, kind: str, text: str, data: Mapping[str, object] | None = None) -> object:
        """Take over one event."""
