"""Session files for tests."""

from pathlib import Path

import numpy as np

from palpate.control.loop.tick_record import tick_stream
from palpate.control.probing.plan import ProbingPlan
from palpate.robot_io.session import Event, Session, SessionMetadata, write_session
from tests.palpate import synthetic

QUICK = Path(__file__).with_name("quick.yaml")
QUICK_RUN = ProbingPlan.load(QUICK)
EVENTS = (
    Event(0.333, "touch", "touched the object", {"run": 0}),
    Event(1.0, "note", "[bold]not markup\x1b[2J"),
)


def synthetic_session(path, **metadata):
    """A session of the synthetic arm."""
    stream = tick_stream(3)
    columns = synthetic.ticks()
    known = {column.name: columns[column.name] for column in stream.columns}
    defaults = {
        "urdf": synthetic.urdf(),
        "software_version": "0.1.0",
        "seed": 7,
        "created_utc": "2026-01-02T03:04:05+00:00",
        "command_line": "palpate probe",
    }
    return write_session(path, [(stream, known)], SessionMetadata(**(defaults | metadata)), EVENTS)


def cut(recorded, path, share):
    """The first part of a session, as if its program had been killed."""
    whole = Session.open(recorded)
    ticks = whole.samples("tick")
    part = ticks.select(np.arange(int(share * len(ticks))))
    return write_session(path, [(part.stream, {name: part[name] for name in part})], whole.metadata)
