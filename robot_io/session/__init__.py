"""The session log: what happened in every tick, in one file that can be understood alone."""

from robot_io.session.event import Event
from robot_io.session.metadata import SessionMetadata
from robot_io.session.stream import Column, RecordArray, Stream
from robot_io.session.writer import SessionWriter

__all__ = ["Column", "Event", "RecordArray", "SessionMetadata", "SessionWriter", "Stream"]
