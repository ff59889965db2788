"""A recording file that appears whole or not at all, and curves in it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from palpate.common.files import whole_file
from palpate.render import palette
from robot_io.files.whole_file import as_utf8
from robot_io.types import FloatArray

TIME, REVISION = "time", "revision"  # timelines
BACKGROUND = (24, 29, 36)
WHOLE_TIME = rrb.TimeAxis(
    view_range=rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
)
Line = tuple[FloatArray, str, float]  # values (n,), colour, width in points


@contextmanager
def recording_file(name: str, path: Path, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Open a new .rrd file for writing.

    Args:
        name: of the recording.
        path: the file; replaced if it is there.
        blueprint: how it is shown.

    Raises:
        InputError: the file cannot be written.
    """
    # Into memory and only then to the disk: Rerun's own writer waits forever when the disk is full.
    with whole_file(path) as unfinished:
        unfinished.touch()  # before the work, so that a folder that is not there is said at once
        name = as_utf8(name)
        recording = rr.RecordingStream("palpate", recording_id=name)
        memory = recording.memory_recording()
        recording.send_blueprint(blueprint)
        recording.send_recording_name(name)
        try:
            yield recording
        finally:  # also where drawing failed: Rerun would warn about data that nobody took
            content = memory.drain_as_bytes()
        unfinished.write_bytes(content or b"")


def time_column(time_s: FloatArray) -> list[rr.TimeColumn]:
    """The timeline of a session."""
    return [rr.TimeColumn(TIME, duration=time_s)]


def send_lines(
    recording: rr.RecordingStream, entity: str, time_s: FloatArray, lines: Mapping[str, Line]
) -> None:
    """Send several curves over `time_s` (n,) [s] as one entity, in one go; by the name in the legend."""
    look = rr.SeriesLines(
        names=list(lines),
        colors=[palette.rgb(color) for _, color, _ in lines.values()],
        widths=[width for *_, width in lines.values()],
    )
    recording.log(entity, look, static=True)
    scalars = np.column_stack([values for values, *_ in lines.values()])
    recording.send_columns(entity, indexes=time_column(time_s), columns=rr.Scalars.columns(scalars=scalars))


def plot(
    origin: str, name: str, span: tuple[float, float] | None = None, legend: rrb.Corner2D | None = None
) -> rrb.TimeSeriesView:
    """A plot over all of the time; without a corner for it there is no legend, which would cover curves."""
    axis = rrb.ScalarAxis(range=span) if span else None
    shown = rrb.PlotLegend(legend) if legend else rrb.PlotLegend(visible=False)
    return rrb.TimeSeriesView(origin=origin, name=name, axis_x=WHOLE_TIME, axis_y=axis, plot_legend=shown)


def shown_on(*contents: rrb.Container | rrb.View, timeline: str) -> rrb.Blueprint:
    """A blueprint of tabs, without the panels that a reader does not need; of revisions, at the last one."""
    # what follows stands at the end
    play: Literal["following", "paused"] = "following" if timeline == REVISION else "paused"
    panel = rrb.TimePanel(state="collapsed", timeline=timeline, play_state=play)
    return rrb.Blueprint(rrb.Tabs(*contents), panel, collapse_panels=True)
