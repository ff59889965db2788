"""Events as a text log, and the summary."""

import numpy as np
import rerun as rr

from palpate.views.recording.entities import EVENTS, SUMMARY, time_column
from palpate.views.scene import Scene

TROUBLE = ("stop", "failure", "log_failed", "observer_failed", "obstacle", "missed_surface")
LEVELS = {"trip": rr.TextLogLevel.ERROR} | dict.fromkeys(TROUBLE, rr.TextLogLevel.WARN)


def log(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log each event at its time, and the summary once."""
    if scene.summary:
        recording.log(SUMMARY, rr.TextDocument(scene.summary, media_type=rr.MediaType.MARKDOWN), static=True)
    if not scene.events:
        return
    start_s = scene.ticks["time_s"][0]
    times = np.array([event.time_s - start_s for event in scene.events])
    columns = rr.TextLog.columns(
        text=[f"{event.kind}: {event.text}" for event in scene.events],
        level=[LEVELS.get(event.kind, rr.TextLogLevel.INFO) for event in scene.events],
    )
    recording.send_columns(EVENTS, time_column(times), columns)
