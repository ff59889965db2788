"""The hardware abstraction: what is measured and commanded, drivers, robot file, clock, guard, session."""

from robot_io.session import Column, Samples, Session, SessionMetadata, SessionWriter, Stream, write_session

__all__ = [
    "Column",
    "Samples",
    "Session",
    "SessionMetadata",
    "SessionWriter",
    "Stream",
    "write_session",
]
