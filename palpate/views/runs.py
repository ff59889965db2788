"""What a run was: its approach speed and how it is called in a picture."""

from dataclasses import dataclass

import numpy as np

from control.phases import Phase
from estimation.channel import ChannelData
from palpate.views import style
from robot_io.types import BoolArray

FAST_SHARE = 0.9  # the quantile of inward velocity that stands for "the speed" of a run without phases


@dataclass(frozen=True)
class Run:
    """One run of a channel as a picture shows it.

    Attributes:
        number: as in the data.
        rows: mask of its samples, shape (n,).
        speed_m_s: inward speed before touch, or the quick part of the motion where phases are unknown [m/s].
        color: from slow to fast.
    """

    number: int
    rows: BoolArray
    speed_m_s: float
    color: str

    @property
    def label(self) -> str:
        """The speed in words."""
        speed_mm_s = 1e3 * self.speed_m_s
        return f"{speed_mm_s:.0f} mm/s" if speed_mm_s >= 10 else f"{speed_mm_s:.2g} mm/s"


def runs_by_speed(data: ChannelData) -> list[Run]:
    """The channel's runs from slow to fast."""
    found = [(number, data.run == number) for number in data.runs.tolist() if number >= 0]
    speeds = {number: approach_speed(data, rows) for number, rows in found}
    found.sort(key=lambda pair: speeds[pair[0]])
    colors = style.speed_colors(len(found))
    return [
        Run(number, rows, speeds[number], color) for (number, rows), color in zip(found, colors, strict=True)
    ]


def approach_speed(data: ChannelData, rows: BoolArray) -> float:
    """Inward speed of a run [m/s]."""
    approaching = rows & (data.phase == Phase.APPROACH)
    if approaching.any():
        return float(np.median(data.velocity[approaching]))
    inward = data.velocity[rows & (data.velocity > 0)]
    return float(np.quantile(inward, FAST_SHARE)) if len(inward) else 0.0
