"""A model growing stage by stage, on a timeline of revisions, and its channels over time."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from palpate.render import palette
from palpate.render.recording.budget import budget_tab, log_budget
from palpate.render.recording.chart import HEIGHT, WIDTH, Chart, label, span_of
from palpate.render.recording.stream import (
    BACKGROUND,
    REVISION,
    TIME,
    plot,
    recording_file,
    send_lines,
    shown_on,
)
from palpate.render.terminal import with_interval
from palpate.render.thinning import rows_by_run, run_curves
from palpate.render.view import ChannelView, StudyView

_WIDE = 300.0
_FIRST, _NOW = 42.0, 92.0  # middles of the two bars


def record_rerun(view: StudyView, path: Path) -> None:
    """Write the recording; the file appears whole or not at all.

    Where a diagnosis is known, the first tab of a channel shows its error budget. Where effects were added,
    timeline `revision` shows curves, residual, error and words of each revision,
    beside those of revision 0 in grey. Timeline `time` shows measurement, models and motion over time.

    Raises:
        InputError: the file cannot be written.
    """
    drawn = [channel for channel in view.channels if len(channel.effort)]
    grown = [channel for channel in drawn if len(channel.stages) > 1]
    judged = [channel for channel in drawn if channel.budget is not None]
    tabs = [
        *(budget_tab(f"{c.name}/budget", f"{c.name}: error budget") for c in judged),
        *map(_growth_tab, grown),
        *(_time_tab(c, f"{c.name} over time" if grown else c.name) for c in drawn),
    ]
    timeline = REVISION if grown else TIME
    with recording_file(Path(view.file).name, path, shown_on(*tabs, timeline=timeline)) as recording:
        for channel in judged:
            if channel.budget is not None:
                log_budget(recording, f"{channel.name}/budget", channel.budget)
        for channel in grown:
            _log_curves(recording, channel)
            _log_errors(recording, channel)
            for number in range(len(channel.stages)):
                recording.set_time(REVISION, sequence=number)
                words = rr.TextDocument(_words(channel, number), media_type=rr.MediaType.MARKDOWN)
                recording.log(f"{channel.name}/words", words)
            recording.reset_time()
        for channel in drawn:
            _log_time(recording, channel)


def _log_curves(recording: rr.RecordingStream, channel: ChannelView) -> None:
    """Effort over time and over position, and the residual over position."""
    name, axes, stages = channel.name, channel.axes, channel.stages
    runs = list(rows_by_run(channel.run).values())
    pressed = [rows[channel.engaged[rows]] for rows in runs]
    efforts = span_of(np.concatenate([channel.effort, stages[0].predicted]))
    residuals = span_of(np.concatenate([stages[0].residual, stages[-1].residual]))
    across = span_of(channel.position[channel.engaged])
    effort = Chart(f"{name}/effort", span_of(channel.time_s, 0.0), efforts, "time [s]", axes.effort, _WIDE)
    loop = Chart(f"{name}/loop", across, efforts, axes.position, axes.effort)
    left = Chart(
        f"{name}/residual", across, residuals, axes.position, f"measured − model [{axes.effort_unit}]"
    )

    def log(entity: str, strips: rr.LineStrips2D, *, static: bool = False) -> None:
        recording.log(f"{name}/{entity}", strips, static=static)

    for chart, x, rows in ((effort, channel.time_s, runs), (loop, channel.position, pressed)):
        chart.draw_frame(recording)
        short = chart.entity.rpartition("/")[2]
        measured = chart.strips(run_curves(x, channel.effort, rows), palette.MEASURED, 3.5)
        log(f"{short}/a_measured", measured, static=True)
        first = chart.strips(run_curves(x, stages[0].predicted, rows), palette.BASE, 1.2)
        log(f"{short}/b_first", first, static=True)
        for number, stage in enumerate(stages):
            recording.set_time(REVISION, sequence=number)
            log(f"{short}/model", chart.strips(run_curves(x, stage.predicted, rows), palette.MODEL, 1.6))
        recording.reset_time()
    left.draw_frame(recording)
    first = left.strips(run_curves(channel.position, stages[0].residual, pressed), palette.BASE, 1.2)
    log("residual/a_first", first, static=True)
    for number, stage in enumerate(stages):
        recording.set_time(REVISION, sequence=number)
        curves = run_curves(channel.position, stage.residual, pressed)
        log("residual/now", left.strips(curves, palette.MODEL, 1.4))
    recording.reset_time()


def _log_errors(recording: rr.RecordingStream, channel: ChannelView) -> None:
    """The error of each revision beside that of revision 0, over the noise level."""
    errors, unit, floor = [stage.rmse for stage in channel.stages], channel.axes.effort_unit, channel.floor
    reach = 1.16 * max(errors)
    chart = Chart(f"{channel.name}/error", (0.0, WIDTH), (0.0, reach), "", f"held-out error [{unit}]")
    chart.draw_frame(recording, upright=False)
    line = chart.strips([(np.array([0.0, WIDTH]), np.full(2, floor))], palette.FLOOR, 2.0)
    recording.log(f"{chart.entity}/floor", line, static=True)
    height = float(chart.place(np.zeros(1), np.array([floor]))[0, 1])
    words = label((WIDTH - 18.0, height - 9.0), f"noise level {floor:.3g}", palette.FLOOR)
    recording.log(f"{chart.entity}/floor_word", words, static=True)
    first = f"revision 0: {errors[0]:.3g}"
    chart.log_bar(recording, "first", _FIRST, errors[0], palette.BASE, first, static=True)
    for number, error in enumerate(errors):
        recording.set_time(REVISION, sequence=number)
        text = f"revision {number}: {error:.3g}"
        chart.log_bar(recording, "now", _NOW, error, palette.MEASURED, text, static=False)
    recording.reset_time()


def _words(channel: ChannelView, number: int) -> str:
    stage, unit = channel.stages[number], channel.axes.effort_unit
    lines = [f"### Revision {number}", f"**{stage.label}**{'' if number else ', the base model'}", ""]
    lines += [f"held-out error **{stage.rmse:.4g} {unit}**, noise level {channel.floor:.4g} {unit}", ""]
    lines += [f"`{effect.name}` {effect.equation}  " for effect in stage.effects]
    lines += ["", "| parameter | value | 95 % interval | unit |", "|---|---|---|---|"]
    for one in stage.parameters:
        value, interval = with_interval(one)
        lines.append(f"| {one.effect}.{one.name} | {value} | {interval} | {one.unit} |")
    return "\n".join(lines)


def _log_time(recording: rr.RecordingStream, channel: ChannelView) -> None:
    """Measurement, first and last model, what they leave, and the motion."""
    place, stages = f"{channel.name}/time", channel.shown_stages
    colors = [palette.MODEL] if len(stages) == 1 else [palette.BASE, palette.MODEL]
    models = list(zip(stages, colors, strict=False))
    effort = {"measured": (channel.effort, palette.MEASURED, 2.0)}
    effort |= {stage.name: (stage.predicted, color, 1.2) for stage, color in models}
    send_lines(recording, f"{place}/effort", channel.time_s, effort)
    if models:
        left = {stage.name: (stage.residual, color, 1.0) for stage, color in models}
        send_lines(recording, f"{place}/residual", channel.time_s, left)
    for what, values in (("position", channel.position), ("velocity", channel.velocity)):
        send_lines(recording, f"{place}/{what}", channel.time_s, {what: (values, palette.MEASURED, 1.2)})


def _time_tab(channel: ChannelView, name: str) -> rrb.Vertical:
    place, axes, corner = f"{channel.name}/time", channel.axes, rrb.Corner2D.LeftTop
    plots = [plot(f"{place}/effort", axes.effort, legend=corner)]
    if channel.stages:
        plots.append(plot(f"{place}/residual", f"measured − model [{axes.effort_unit}]", legend=corner))
    plots += [plot(f"{place}/position", axes.position), plot(f"{place}/velocity", axes.velocity)]
    return rrb.Vertical(*plots, row_shares=[3, 2, 1, 1][-len(plots) :], name=name)


def _growth_tab(channel: ChannelView) -> rrb.Horizontal:
    name = channel.name
    curves = rrb.Vertical(
        _view(f"{name}/effort", "Measured (blue), revision 0 (grey), this revision (orange)", _WIDE),
        rrb.Horizontal(
            _view(f"{name}/loop", "Over the state"),
            _view(f"{name}/residual", "What is left: revision 0 (grey), this revision (orange)"),
        ),
    )
    words = rrb.TextDocumentView(origin=f"{name}/words", name="This revision")
    errors = rrb.Vertical(_view(f"{name}/error", "Error in held-out runs"), words)
    return rrb.Horizontal(curves, errors, column_shares=[2, 1], name=name)


def _view(origin: str, name: str, width: float = WIDTH) -> rrb.Spatial2DView:
    frame = rrb.VisualBounds2D(x_range=[-16.0, width + 6.0], y_range=[-14.0, HEIGHT + 18.0])
    background = rrb.Background(color=BACKGROUND)
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=frame, background=background)
