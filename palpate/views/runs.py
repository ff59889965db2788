"""What a run was: its approach speed, how it is called and which colour it has in a picture."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.lines import Line2D

from control.loop.phases import Phase
from estimation.channel import ChannelData
from palpate.views import style
from robot_io.types import BoolArray

FAST_SHARE = 0.9  # the quantile of inward velocity that stands for "the speed" of a run without phases
MILLI = 1e3
MOST_NAMED = 12  # runs in a legend


@dataclass(frozen=True)
class Run:
    """One run of a channel as a picture shows it.

    Attributes:
        number: as in the data.
        rows: mask of its samples, shape (n,).
        speed_m_s: inward speed before touch, or the quick part of the motion where phases are unknown [m/s].
        label: the speed in words, or the run's number where all have the same speed.
        color: from slow to fast.
    """

    number: int
    rows: BoolArray
    speed_m_s: float
    label: str
    color: str


def runs_by_speed(data: ChannelData) -> list[Run]:
    """The channel's runs from slow to fast; runs of the same speed have the same colour."""
    found = [(number, data.run == number) for number in data.runs.tolist() if number >= 0]
    speeds = {number: approach_speed(data, rows) for number, rows in found}
    labels = {number: _speed_label(speed) for number, speed in speeds.items()}
    if len(set(labels.values())) == 1 < len(found):
        labels = {number: f"run {number}" for number in labels}
    else:
        found.sort(key=lambda pair: speeds[pair[0]])
    distinct = list(dict.fromkeys(labels[number] for number, _ in found))
    colors = dict(zip(distinct, style.speed_colors(len(distinct)), strict=True))
    return [Run(n, rows, speeds[n], labels[n], colors[labels[n]]) for n, rows in found]


def approach_speed(data: ChannelData, rows: BoolArray) -> float:
    """Inward speed of a run [m/s]."""
    approaching = rows & (data.phase == Phase.APPROACH)
    if approaching.any():
        return float(np.median(data.velocity[approaching]))
    inward = data.velocity[rows & (data.velocity > 0)]
    return float(np.quantile(inward, FAST_SHARE)) if len(inward) else 0.0


def legend_of(runs: Sequence[Run], **look: object) -> list[Line2D]:
    """One legend entry a colour; none where there would be too many to read."""
    named = {run.label: run.color for run in runs}
    if len(named) > MOST_NAMED:
        return []
    return [Line2D([], [], color=color, label=label, **look) for label, color in named.items()]  # type: ignore[arg-type]


def _speed_label(speed_m_s: float) -> str:
    speed_mm_s = MILLI * speed_m_s
    return f"{speed_mm_s:.0f} mm/s" if speed_mm_s >= 10 else f"{speed_mm_s:.2g} mm/s"
