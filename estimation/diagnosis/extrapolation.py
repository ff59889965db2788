"""Error at motions that only one run contains: no other run determines a law there."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.estimate import with_unit
from palpate.estimation.fit.fit_result import FitResult
from palpate.robot_io.types import BoolArray

_MIN_SHARE = 0.5  # least share of the squared error for it to be reported
_MARGIN = 0.02  # distance from the range of the other runs, relative to it, from which a motion is beyond it


@dataclass(frozen=True)
class Extrapolation:
    """The part of the held-out error beyond the motion of the runs that were used for the fit."""

    share: float  # share of the squared error at motions that only one run contains
    where: str  # the run and the range with the largest part of it, such as "run 2, at depths above 12 mm"
    run: int  # this run

    @property
    def sentence(self) -> str:
        """Clause that states the share and the place."""
        return (
            f"{100 * self.share:.0f} % of this squared error lies where only one run moves, most of it in "
            f"{self.where}, which a fit to the other runs cannot predict reliably"
        )

    @property
    def instruction(self) -> str:
        """Instruction for the next experiment."""
        return f"repeat the motion of run {self.run}, so that at least two runs contain it"


def extrapolation(fit: FitResult) -> Extrapolation | None:
    """Find out whether most of a model's error lies at positions or velocities that only one run contains.

    Args:
        fit: the model, whose residual is held out by run.

    Returns:
        The extrapolation; None if less than half of the squared error lies there, or if there is one run.
    """
    data, scored = fit.data, fit.scored
    runs = [run for run in data.runs if np.any(scored & (data.run == run))]
    squared = np.where(scored, np.nan_to_num(fit.residual), 0.0) ** 2
    total = float(squared.sum())
    if len(runs) < 2 or total == 0.0:
        return None
    beyond, largest = np.zeros(len(data), dtype=np.bool_), (0.0, 0, "")
    for run in runs:
        own, others = scored & (data.run == run), scored & (data.run != run)
        for where, part in _beyond(data, own, others):
            beyond |= part
            largest = max(largest, (float(squared[part].sum()), int(run), where))
    share = float(squared[beyond].sum()) / total
    if share < _MIN_SHARE:
        return None
    return Extrapolation(share, f"run {largest[1]}, at {largest[2]}", largest[1])


def _beyond(data: ChannelData, own: BoolArray, others: BoolArray) -> list[tuple[str, BoolArray]]:
    """Return the samples of one run beyond the range of the others at each end, and this range in words."""
    distance, scale = ("rad", 1.0) if data.kind.is_angle else ("mm", 1e3)
    position = "depths" if data.kind is ChannelKind.CONTACT else "positions"
    parts = []
    signals = ((position, data.position, distance), ("velocities", data.velocity, f"{distance}/s"))
    for name, signal, unit in signals:
        low, high = float(signal[others].min()), float(signal[others].max())
        margin = _MARGIN * (high - low)
        parts += [
            (f"{name} above {with_unit(scale * high, unit)}", own & (signal > high + margin)),
            (f"{name} below {with_unit(scale * low, unit)}", own & (signal < low - margin)),
        ]
    return parts
