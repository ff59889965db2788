"""Names and small helpers that the layers share."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from palpate.views.colors import Color
from robot_io.types import FloatArray

TIMELINE = "time"
REVISION = "revision"  # timeline of a model that grows
ROOT_FRAME = "world"  # of everything that is drawn and is no part of the arm

ARM = "arm"
OBJECT = "object"
TIP = "tip"
FORCE = "contact/force"
DEPTH = "contact/displacement"
PHASE = "phase"
TORQUE = "torque"
POSITION = "position"
TRACKING = "tracking"
STIFFNESS = "estimate/stiffness"
DAMPING = "estimate/damping"
EVENTS = "events"
SUMMARY = "summary"
TIMING = "timing"


def time_column(time_s: FloatArray) -> list[rr.TimeColumn]:
    """The one timeline of a session."""
    return [rr.TimeColumn(TIMELINE, duration=time_s)]


def send_lines(
    recording: rr.RecordingStream,
    entity: str,
    time_s: FloatArray,
    lines: Mapping[str, tuple[FloatArray, Color]],
    widths: Sequence[float],
) -> None:
    """Send several curves as one entity, in one go.

    Args:
        recording: where to.
        entity: path of the entity.
        time_s: shape (n,) [s].
        lines: values (n,) and colour by the name in the legend.
        widths: line width of each, in points.
    """
    colors = [color for _, color in lines.values()]
    recording.log(entity, rr.SeriesLines(names=list(lines), colors=colors, widths=list(widths)), static=True)
    scalars = np.column_stack([values for values, _ in lines.values()])
    recording.send_columns(entity, indexes=time_column(time_s), columns=rr.Scalars.columns(scalars=scalars))
