"""The session log: every tick of a run in one self-contained file."""

from palpate.robot_io.session.event import Event, SessionMetadata
from palpate.robot_io.session.reader import Session, SessionTail
from palpate.robot_io.session.stream import Column, RecordArray, Samples, Stream
from palpate.robot_io.session.writer import SessionWriter, write_session

__all__ = [
    "Column",
    "Event",
    "RecordArray",
    "Samples",
    "Session",
    "SessionMetadata",
    "SessionTail",
    "SessionWriter",
    "Stream",
    "write_session",
]
