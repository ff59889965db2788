"""Imported measurements: effort and position over time, run after run, with what a model makes of them."""

from collections.abc import Sequence
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from estimation.channel import ChannelData
from palpate.findings.estimation_run import ChannelEstimates
from palpate.views import colors
from palpate.views.recording.blueprint import WHOLE_TIME
from palpate.views.recording.entities import SUMMARY, TIMELINE, send_lines
from palpate.views.recording.file import recording_file
from palpate.views.time_axis import one_after_the_other
from robot_io.types import FloatArray


def write_channels(
    name: str, channels: Sequence[ChannelData], found: ChannelEstimates | None, summary: str, path: Path
) -> float:
    """Write the recording of a session that was imported.

    Args:
        name: what to call it.
        channels: what was imported.
        found: estimates of one of the channels, if there are any.
        summary: markdown for people.
        path: the .rrd file.

    Returns:
        A moment worth a picture, in the middle [s].

    Raises:
        InputError: the file cannot be written.
    """
    with recording_file(name, path, _blueprint(channels)) as recording:
        recording.log(SUMMARY, rr.TextDocument(summary, media_type=rr.MediaType.MARKDOWN), static=True)
        for channel in channels:
            prediction = found.prediction() if found is not None and found.channel is channel else None
            _log_channel(recording, channel, prediction)
    return float(one_after_the_other(channels[0])[-1] / 2)


def _log_channel(recording: rr.RecordingStream, channel: ChannelData, prediction: FloatArray | None) -> None:
    time_s = one_after_the_other(channel)
    effort = {"measured": (channel.effort, colors.MEASURED)}
    if prediction is not None:
        effort["model"] = (prediction, colors.COMMANDED)
    send_lines(recording, f"{channel.name}/effort", time_s, effort, [1.5] * len(effort))
    position = {"position": (channel.position, colors.MEASURED)}
    send_lines(recording, f"{channel.name}/position", time_s, position, (1.5,))
    velocity = {"velocity": (channel.velocity, colors.FINAL)}
    send_lines(recording, f"{channel.name}/velocity", time_s, velocity, (1.0,))


def _blueprint(channels: Sequence[ChannelData]) -> rrb.Blueprint:
    tabs = [rrb.Vertical(*_plots(channel), name=channel.name) for channel in channels]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Tabs(*tabs), rrb.TextDocumentView(origin=SUMMARY, name="Summary"), column_shares=[3, 1]
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        collapse_panels=True,
    )


def _plots(channel: ChannelData) -> list[rrb.TimeSeriesView]:
    position, effort = channel.kind.position_unit, channel.kind.effort_unit
    names = {
        "effort": f"Effort [{effort}]",
        "position": f"Position [{position}]",
        "velocity": f"Velocity [{position}/s]",
    }
    return [
        rrb.TimeSeriesView(origin=f"{channel.name}/{part}", name=name, axis_x=WHOLE_TIME)
        for part, name in names.items()
    ]
