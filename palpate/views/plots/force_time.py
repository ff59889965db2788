"""Force over time, run by run, with the force aimed at and what the arm was doing."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimation.channel import ChannelData
from palpate.views import style
from palpate.views.plots.phase_strip import draw_phase_strip, hide_strip, phase_legend
from palpate.views.runs import Run, runs_by_speed
from robot_io.types import BoolArray, FloatArray

BEFORE_TOUCH_S = 0.15
MOST_RUNS = 4  # panels side by side; more runs than this are represented by evenly chosen ones


def force_time_figure(
    data: ChannelData, desired_n: FloatArray | None, prediction: FloatArray | None
) -> Figure:
    """One panel a run, time counted from the touch.

    Args:
        data: contact channel, n samples; displacement counted from the surface.
        desired_n: force aimed at (n,), NaN where the force is free; None where it is unknown.
        prediction: the model's force (n,), or None.
    """
    runs = _choose(runs_by_speed(data))
    figure = style.new_figure(3.0 + 2.2 * len(runs), 3.9)
    panels = figure.subplots(
        2, len(runs), sharex="col", sharey="row", squeeze=False, gridspec_kw={"height_ratios": [1, 0.055]}
    )
    shown = np.zeros(len(data), bool)
    phases_known = bool((data.phase >= 0).any())
    for column, run in enumerate(runs):
        rows = run.rows & _around_contact(data, run)
        shown |= rows
        _draw_run(panels[0, column], data, rows, run, desired_n=desired_n, prediction=prediction)
        if phases_known:
            draw_phase_strip(panels[1, column], _since_touch(data, run)[rows], data.phase[rows])
        else:
            hide_strip(panels[1, column])
        panels[1, column].set_xlabel("time since touch  [s]")
    panels[0, 0].set_ylabel("contact force  [N]")
    figure.legend(
        handles=_handles(desired_n, prediction, data, shown),
        loc="outside lower center",
        ncols=9,
        fontsize=8.5,
    )
    style.title(figure, "Force over time", "Each run from shortly before the touch until contact is lost")
    return figure


def _choose(runs: list[Run]) -> list[Run]:
    chosen = np.unique(np.linspace(0, len(runs) - 1, min(len(runs), MOST_RUNS)).round().astype(int))
    return [runs[i] for i in chosen.tolist()]


def _since_touch(data: ChannelData, run: Run) -> FloatArray:
    touching = np.flatnonzero(run.rows & (data.position > 0))
    first = touching[0] if len(touching) else np.flatnonzero(run.rows)[0]
    since: FloatArray = data.time_s - data.time_s[first]
    return since


def _around_contact(data: ChannelData, run: Run) -> BoolArray:
    touching = np.flatnonzero(run.rows & (data.position > 0))
    since = _since_touch(data, run)
    last = since[touching[-1]] if len(touching) else since[run.rows][-1]
    window: BoolArray = (since >= -BEFORE_TOUCH_S) & (since <= last + BEFORE_TOUCH_S)
    return window


def _draw_run(
    axes: Axes,
    data: ChannelData,
    rows: BoolArray,
    run: Run,
    *,
    desired_n: FloatArray | None,
    prediction: FloatArray | None,
) -> None:
    time_s = _since_touch(data, run)[rows]
    axes.plot(time_s, data.effort[rows], color=run.color, linewidth=1.2, alpha=0.85)
    if prediction is not None:
        axes.plot(time_s, prediction[rows], color=style.INK, linewidth=1.0, dashes=(4, 2))
    if desired_n is not None:
        axes.plot(time_s, desired_n[rows], color=style.DESIRED, linewidth=1.1, dashes=(1, 1.5))
    axes.set_title(run.label, color=run.color)
    axes.set_xlim(time_s[0], time_s[-1])


def _handles(
    desired_n: FloatArray | None, prediction: FloatArray | None, data: ChannelData, shown: BoolArray
) -> list[object]:
    lines: list[object] = []
    if prediction is not None:
        lines.append(Line2D([], [], color=style.INK, linewidth=1, dashes=(4, 2), label="model"))
    if desired_n is not None:
        lines.append(Line2D([], [], color=style.DESIRED, linewidth=1.1, dashes=(1, 1.5), label="aimed at"))
    phases = data.phase[shown & (data.phase >= 0)]
    return lines + list(phase_legend(phases))
