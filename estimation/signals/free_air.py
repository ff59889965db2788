"""Estimate the zero and drift of a sensor from readings in free air."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.signals.blocks import rows_of_runs

_FREE = 0.9  # share of the samples before a contact that is used; the last ones may be in contact
_WINDOW = 50  # largest number of readings used at the end of a run
_FEWEST = 5  # readings needed at each end
_HIDDEN = 0.5  # least bias that is visible, relative to the noise
_SIGMAS = 3.0  # standard errors below which a rate may be zero


@dataclass(frozen=True)
class FreeAirZero:
    """Zero of a sensor, from readings in free air."""

    noise: float  # standard deviation of readings before the first contact, about each run's mean [effort]
    bias: float  # mean of these readings [effort]
    rate: float | None  # drift from the start to the end of runs [effort/s]; None if unknown
    rate_std_err: float  # standard error of the rate for white noise [effort/s]
    duration_s: float  # time from the first to the last reading of the channel [s]

    @property
    def is_zero(self) -> bool:
        """Whether readings before the contact show no bias."""
        return abs(self.bias) < _HIDDEN * self.noise

    @property
    def is_steady(self) -> bool:
        """Whether readings at the ends of runs show no drift over the recording."""
        if self.rate is None:
            return False
        unseen = max(_HIDDEN * self.noise, _SIGMAS * self.rate_std_err * self.duration_s)
        return abs(self.rate) * self.duration_s < unseen


def zero_in_free_air(data: ChannelData) -> FreeAirZero | None:
    """Estimate a sensor's zero from the runs that begin in free air.

    Args:
        data: the channel.

    Returns:
        The zero; None for joints, and if no run begins in free air.
    """
    if data.kind is not ChannelKind.CONTACT:
        return None
    before, apart_s, apart, spread = [], [], [], []
    for rows in rows_of_runs(data.run):
        touched = np.flatnonzero(data.engaged[rows])
        first = rows[: int(_FREE * (touched[0] if len(touched) else len(rows)))]
        if len(first) < _FEWEST:
            continue
        before.append(data.effort[first])
        last = rows[touched[-1] + 1 :][-_WINDOW:] if len(touched) else first[:0]
        if len(last) >= _FEWEST:
            start = first[: len(last)]
            apart_s.append(data.time_s[last].mean() - data.time_s[start].mean())
            apart.append(data.effort[last].mean() - data.effort[start].mean())
            spread.append(2.0 / len(start))
    if not before:
        return None
    noise = float(np.std(np.concatenate([part - part.mean() for part in before])))
    bias, energy = float(np.concatenate(before).mean()), float(np.vdot(apart_s, apart_s))
    rate = float(np.vdot(apart_s, apart)) / energy if energy > 0.0 else None
    error = noise * float(np.sqrt(max(spread) / energy)) if energy > 0.0 else np.inf
    return FreeAirZero(noise, bias, rate, error, float(np.ptp(data.time_s)))
