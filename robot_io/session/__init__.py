"""The session log: every tick of a run in one self-contained file."""

from palpate.robot_io.session.event import Event, SessionMetadata
from palpate.robot_io.session.reader import Follower, Session
from palpate.robot_io.session.stream import Column, RecordArray, Samples, Stream
from palpate.robot_io.session.writer import SessionWriter, write_session

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
