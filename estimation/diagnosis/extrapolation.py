"""Error at motions that only one run contains: no other run determines a law there."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from palpate.estimation.channel import ChannelKind
from palpate.estimation.estimate import with_unit
from palpate.estimation.fit.fit_result import FitResult

_MIN_SHARE = 0.5  # least share of the squared error for it to be reported
_MARGIN = 0.02  # distance from the range of the other runs, relative to it, from which a motion is beyond it


@dataclass(frozen=True)
class Extrapolation:
    """The part of the held-out error beyond the motion of the runs that were used for the fit."""

    share: float  # share of the squared error at motions that only one run contains
    where: str  # run and range with the largest part, such as "run 2, at depths of more than 12 mm"
    run: int  # this run

    def describe(self, error: str) -> str:
        """Return a clause on the share and the place.

        Args:
            error: name of the error, such as "squared error".
        """
        return (
            f"{100 * self.share:.0f} % of the {error} lies at positions or velocities that only one run "
            f"contains (the largest part in {self.where}), so a fit to the other runs cannot predict this "
            "part reliably"
        )


def extrapolation(fit: FitResult) -> Extrapolation | None:
    """Find out whether most squared error lies at positions or velocities of only one run; None if not.

    Args:
        fit: the model, whose residual is held out. Each run is compared with all others, even if several runs
            were left out of a fit together.
    """
    data, scored = fit.data, fit.scored
    runs = [run for run in data.runs if np.any(scored & (data.run == run))]
    squared = np.where(scored, np.nan_to_num(fit.residual), 0.0) ** 2
    total = float(squared.sum())
    if len(runs) < 2 or total == 0.0:
        return None
    beyond, largest = np.zeros(len(data), dtype=np.bool_), (0.0, 0, "")
    unit, scale = ("rad", 1.0) if data.kind.is_angle else ("mm", 1e3)
    signals = ("positions", data.position, unit), ("velocities", data.velocity, f"{unit}/s")
    for run, (name, signal, unit_of_signal) in product(runs, signals):
        own, others = scored & (data.run == run), scored & (data.run != run)
        low, high = float(signal[others].min()), float(signal[others].max())
        lowest, highest = (with_unit(scale * end, unit_of_signal) for end in (low, high))
        margin = _MARGIN * (high - low)
        above, below = own & (signal > high + margin), own & (signal < low - margin)
        words = f"{name} above {highest}", f"{name} below {lowest}"
        if data.kind is ChannelKind.CONTACT and signal is data.position:
            words = f"depths of more than {highest}", f"depths of less than {lowest}"
            below &= signal > 0.0  # in free air the force does not depend on the distance
        for where, part in zip(words, (above, below), strict=True):
            beyond |= part
            largest = max(largest, (float(squared[part].sum()), int(run), where))
    share = float(squared[beyond].sum()) / total
    if share < _MIN_SHARE:
        return None
    return Extrapolation(share, f"run {largest[1]}, at {largest[2]}", largest[1])
