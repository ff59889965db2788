"""The session log: what happened in every tick, in one file that can be understood alone."""

from robot_io.session.event import Event
from robot_io.session.metadata import SessionMetadata
from robot_io.session.reader import Follower, Session
from robot_io.session.samples import Samples
from robot_io.session.stream import Column, RecordArray, Stream
from robot_io.session.writer import SessionWriter, write_session

__all__ = [
    "Column",
    "Event",
    "Follower",
    "RecordArray",
    "Samples",
    "Session",
    "SessionMetadata",
    "SessionWriter",
    "Stream",
    "write_session",
]
