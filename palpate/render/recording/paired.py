"""Two sides in Rerun: both measurements over one time, with their models and what those leave."""

from pathlib import Path

import rerun.blueprint as rrb

from palpate.render.paired import LETTERS, PairedView, PairView
from palpate.render.paired_report import COLORS
from palpate.render.recording.stream import TIME, plot, recording_file, send_lines, shown_on


def record_pair(view: PairView, path: Path) -> None:
    """Write the recording; the file appears whole or not at all.

    Timeline `time` is that of each side, its runs one after the other; a repetition is at the times of A.

    Raises:
        InputError: the file cannot be written.
    """
    tabs = [_tab(channel) for channel in view.channels]
    with recording_file(view.title, path, shown_on(*tabs, timeline=TIME)) as recording:
        for one in view.channels:
            for letter, color, channel in zip(LETTERS, COLORS, one.views, strict=True):
                overlay = one.found.overlay if letter == LETTERS[1] else None
                time_s = channel.time_s if overlay is None else one.views[0].time_s
                effort = channel.effort if overlay is None else overlay
                measured = {f"{letter} measured": (effort, color, 2.0)}
                send_lines(recording, f"{one.channel}/effort/{letter}", time_s, measured)
                for stage in channel.stages[-1:]:
                    left = {f"left by {letter}'s model": (stage.residual, color, 1.0)}
                    send_lines(recording, f"{one.channel}/residual/{letter}", channel.time_s, left)
                motion = {f"{letter}": (channel.position, color, 1.2)}
                send_lines(recording, f"{one.channel}/position/{letter}", channel.time_s, motion)


def _tab(view: PairedView) -> rrb.Vertical:
    axes, corner = view.views[0].axes, rrb.Corner2D.LeftTop
    plots = [
        plot(f"{view.channel}/effort", axes.effort, legend=corner),
        plot(f"{view.channel}/residual", f"measured − model [{axes.effort_unit}]", legend=corner),
        plot(f"{view.channel}/position", axes.position, legend=corner),
    ]
    return rrb.Vertical(*plots, row_shares=[3, 2, 1], name=view.channel)
