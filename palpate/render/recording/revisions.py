"""Revisions of a model in Rerun: channels over time, plots and error budgets.

Rerun's own plots run along a timeline. Here the timeline is the revision, and each revision has whole
curves, which are drawn as lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.estimation.estimate import with_unit
from palpate.render import palette
from palpate.render.recording.file import (
    BACKGROUND,
    REVISION,
    TIME,
    markdown,
    plot,
    recording_file,
    send_lines,
    shown_on,
)
from palpate.render.recording.rerun_modules import rr, rrb
from palpate.render.terminal import with_interval
from palpate.render.thinning import rows_by_run, run_curves
from palpate.render.view import RANGE, RANGE_MEANING, BudgetView, ChannelView, StudyView
from palpate.robot_io.types import FloatArray

WIDTH, HEIGHT = 160.0, 90.0  # size of the frame in the view's units
_RULE, _INK = (62, 72, 84), (190, 200, 210)
_TICKS = 5
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
_LABEL_DROP = 3.5  # Rerun draws a label below its point


@dataclass(frozen=True)
class Chart:
    """A frame with axes."""

    entity: str  # path of its entities
    x: tuple[float, float]  # smallest and largest value of the horizontal axis
    y: tuple[float, float]  # the same for the vertical one
    x_label: str  # title of the horizontal axis, with unit
    y_label: str  # the same for the vertical one
    width: float = WIDTH  # of the frame, in the view's own units

    def place(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return points (n, 2) in the view, clipped to the frame; its vertical axis points down.

        Args:
            x: shape (n,).
            y: shape (n,).
        """
        across = (np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0])
        up = np.clip((np.asarray(y) - self.y[0]) / (self.y[1] - self.y[0]), -0.02, 1.02)
        placed: FloatArray = np.column_stack([self.width * across, HEIGHT * (1.0 - up)])
        return placed

    def draw_frame(self, recording: rr.RecordingStream) -> None:
        """Draw grid lines and labels, once for all revisions.

        Args:
            recording: destination.
        """
        rules = [self.place(np.array(self.x), np.full(2, value)) for value in ticks(*self.y)]
        words = [
            ((-7.0, float(rule[0, 1]) - _LABEL_DROP), f"{value:g}")
            for rule, value in zip(rules, ticks(*self.y), strict=True)
        ]
        words.append(((14.0, -11.0), self.y_label))
        across = [self.place(np.full(2, value), np.array(self.y)) for value in ticks(*self.x)]
        below = zip(across, ticks(*self.x), strict=True)
        words += [((float(rule[0, 0]), HEIGHT + 1.0), f"{value:g}") for rule, value in below]
        words.append(((self.width / 2, HEIGHT + 8.0), self.x_label))
        rules += across
        lines = rr.LineStrips2D(rules, colors=_RULE, radii=rr.Radius.ui_points(0.5))
        recording.log(f"{self.entity}/frame", lines, static=True)
        places, labels = zip(*words, strict=True)
        written = rr.Points2D(places, labels=labels, colors=_INK, radii=0.0, show_labels=True)
        recording.log(f"{self.entity}/words", written, static=True)

    def strips(
        self, curves: Sequence[tuple[FloatArray, FloatArray]], color: str, width: float
    ) -> rr.LineStrips2D:
        """Return curves (x, y) of one color without values that are not finite.

        Args:
            curves: x (n,) and y (n,) of each.
            color: "#rrggbb".
            width: width of the lines [points].
        """
        finite = [(x[np.isfinite(y)], y[np.isfinite(y)]) for x, y in curves]
        placed = [self.place(x, y) for x, y in finite if len(x) > 1]
        return rr.LineStrips2D(placed, colors=palette.rgb(color), radii=rr.Radius.ui_points(width / 2))


def _span_of(values: FloatArray, margin: float = 0.06) -> tuple[float, float]:
    """Return the smallest and largest finite value, with a margin; 0 to 1 plus the margin without any."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    room = margin * (high - low) or 1.0
    return low - room, high + room


def ticks(low: float, high: float) -> list[float]:
    """Return about five round values from low to high.

    Args:
        low: lower end of an axis, less than `high`.
        high: upper end.
    """
    least = (high - low) / _TICKS
    unit = 10.0 ** np.floor(np.log10(least))
    step = next(factor * unit for factor in _STEPS if factor * unit >= least * (1.0 - 1e-9))
    counts = np.arange(np.ceil(low / step), np.floor(high / step) + 1.0)
    return [round(float(value), 12) + 0.0 for value in counts * step]  # no -0


def budget_markdown(budget: BudgetView) -> str:
    """Describe an error budget as Markdown, with a table of its parts."""
    lines = ["### Error budget", budget.sentence, ""]
    lines += [f"| kind | share | 95 % interval | {RANGE} | form | effects |", "|---" * 6 + "|"]
    for part in budget.parts:
        interval = f"{100 * part.interval[0]:.0f} to {100 * part.interval[1]:.0f} %" if part.interval else ""
        cells = part.word, part.share_text, interval, part.range_text, part.form, part.effects_text
        lines.append(f"| {' | '.join(cells)} |")
    lines.append(f"\nShares of the base model's squared error in held-out runs. {RANGE_MEANING}")
    lines += [f"\n{sentence}" for sentence in (*budget.form_meanings, *budget.confusions)]
    return "\n".join(lines)


_WIDE = 300.0


def record_rerun(view: StudyView, path: Path) -> None:
    """Write the recording, completely or not at all.

    If effects were added, timeline `revision` shows curves, residual, error and sentences of each revision,
    beside those of revision 0 in gray. If a diagnosis is known, the sentence of its error budget comes first,
    and a tab has the budget's table. Timeline `time` shows measurement, models and motion over time.

    Args:
        view: all channels.
        path: path of the .rrd file.

    Raises:
        InputError: the file cannot be written.
    """
    drawn = [channel for channel in view.channels if len(channel.effort)]
    grown = [channel for channel in drawn if len(channel.stages) > 1]
    budgets = {channel.name: channel.budget for channel in drawn if channel.budget is not None}
    tabs: list[rrb.Container | rrb.View] = []
    for channel in grown:
        name, title = channel.name, f"Error in held-out runs [{channel.axes.effort_unit}]"
        drawings = rrb.Vertical(
            _view(f"{name}/effort", "Measured (blue), revision 0 (gray), this revision (orange)", _WIDE),
            rrb.Horizontal(
                _view(f"{name}/loop", "Over position"),
                _view(f"{name}/residual", "Residual: revision 0 (gray), this revision (orange)"),
            ),
        )
        words = rrb.TextDocumentView(origin=f"{name}/words", name="This revision")
        reach = (0.0, 1.16 * max(stage.rmse for stage in channel.stages))
        notes = rrb.Vertical(plot(f"{name}/error", title, reach, rrb.Corner2D.RightTop), words)
        tabs.append(rrb.Horizontal(drawings, notes, column_shares=[2, 1], name=name))
    for name in budgets:
        tabs.append(rrb.TextDocumentView(origin=f"{name}/budget", name=f"{name}: error budget"))
    for channel in drawn:
        place, axes, corner = f"{channel.name}/time", channel.axes, rrb.Corner2D.LeftTop
        plots = [plot(f"{place}/effort", axes.effort, legend=corner)]
        if channel.stages:
            plots.append(plot(f"{place}/residual", axes.residual, legend=corner))
        plots += [plot(f"{place}/position", axes.position), plot(f"{place}/velocity", axes.velocity)]
        name = f"{channel.name} over time" if grown else channel.name
        tabs.append(rrb.Vertical(*plots, row_shares=[3, 2, 1, 1][-len(plots) :], name=name))
    timeline = REVISION if grown else TIME
    with recording_file(Path(view.file).name, path, shown_on(*tabs, timeline=timeline)) as recording:
        for name, budget in budgets.items():
            recording.log(f"{name}/budget", markdown(budget_markdown(budget)), static=True)
        for channel in grown:
            _log_curves(recording, channel)
            errors = np.array([stage.rmse for stage in channel.stages])
            revisions = [rr.TimeColumn(REVISION, sequence=np.arange(len(errors)))]
            levels = {
                "held-out error": (errors, palette.MEASURED, 2.0),
                channel.noise_label: (np.full(len(errors), channel.noise_level), palette.NOISE, 2.0),
            }
            send_lines(recording, f"{channel.name}/error", revisions, levels)
            for number in range(len(channel.stages)):
                recording.set_time(REVISION, sequence=number)
                recording.log(f"{channel.name}/words", markdown(_revision_markdown(channel, number)))
            recording.reset_time()
        for channel in drawn:
            # measurement, first and last model, their residuals, and the motion
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
                motion = {what: (values, palette.MEASURED, 1.2)}
                send_lines(recording, f"{place}/{what}", channel.time_s, motion)


def _revision_markdown(channel: ChannelView, number: int) -> str:
    """Describe a revision of a model as Markdown, below the error budget of the base model."""
    stage, unit = channel.stages[number], channel.axes.effort_unit
    kind = "" if number else ", the base model"
    error = f"held-out error **{with_unit(stage.rmse, unit, 4)}**, "
    error += f"{channel.noise_label} {with_unit(channel.noise_level, unit, 4)}"
    lines = [f"{channel.budget.sentence}\n"] if channel.budget else []
    lines += [f"### Revision {number}", f"**{stage.label}**{kind}", "", error, ""]
    lines += [f"`{effect.name}` {effect.equation}  " for effect in stage.effects]
    lines += ["", "| parameter | value | 95 % interval | unit |", "|---|---|---|---|"]
    for parameter in stage.parameters:
        cells = [parameter.name, *with_interval(parameter), parameter.unit]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _log_curves(recording: rr.RecordingStream, channel: ChannelView) -> None:
    """Log effort over time and position, and the residual over position."""
    name, axes, stages = channel.name, channel.axes, channel.stages
    runs = list(rows_by_run(channel.run).values())
    pressed = [rows[channel.engaged[rows]] for rows in runs]
    efforts = _span_of(np.concatenate([channel.effort, stages[0].predicted]))
    residuals = _span_of(np.concatenate([stages[0].residual, stages[-1].residual]))
    across = _span_of(channel.position[channel.engaged])
    effort = Chart(f"{name}/effort", _span_of(channel.time_s, 0.0), efforts, "time [s]", axes.effort, _WIDE)
    loop = Chart(f"{name}/loop", across, efforts, axes.position, axes.effort)
    left = Chart(f"{name}/residual", across, residuals, axes.position, axes.residual)
    predicted, residual = [stage.predicted for stage in stages], [stage.residual for stage in stages]
    for chart, x, rows, models in (
        (effort, channel.time_s, runs, predicted),
        (loop, channel.position, pressed, predicted),
        (left, channel.position, pressed, residual),
    ):
        chart.draw_frame(recording)
        if models is predicted:
            measured = chart.strips(run_curves(x, channel.effort, rows), palette.MEASURED, 3.5)
            recording.log(f"{chart.entity}/a_measured", measured, static=True)
        first = chart.strips(run_curves(x, models[0], rows), palette.BASE, 1.2)
        recording.log(f"{chart.entity}/b_first", first, static=True)
        for number, values in enumerate(models):
            recording.set_time(REVISION, sequence=number)
            model = chart.strips(run_curves(x, values, rows), palette.MODEL, 1.6)
            recording.log(f"{chart.entity}/model", model)
        recording.reset_time()


def _view(origin: str, name: str, width: float = WIDTH) -> rrb.Spatial2DView:
    frame = rrb.VisualBounds2D(x_range=[-16.0, width + 6.0], y_range=[-14.0, HEIGHT + 18.0])
    background = rrb.Background(color=BACKGROUND)
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=frame, background=background)
