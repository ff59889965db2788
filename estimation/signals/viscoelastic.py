"""Strains that relax, at any times of sampling and with any scale of time."""

import numpy as np
from scipy.special import gamma

from estimation.signals.blocks import places
from estimation.signals.runwise import relax
from robot_io.types import FloatArray, IntArray

_COARSE = 0.004  # of the range of positions, within which a power of it goes straight
_MOST_PARTS = 16
_LADDER = 1.1  # between the logarithms of two rates: two a decade leave less than a part in a thousand
_SLOWEST, _FASTEST = 1e-3, 30.0  # times the whole duration, and the shortest step


def relaxed_power(
    position: FloatArray, time_s: FloatArray, run: IntArray, exponent: float, tau_s: float
) -> FloatArray:
    """What is left of max(x, 0)^n, shape (n,), as it relaxes with one time constant; see `relax`.

    Between samples the position goes straight, however its power bends.
    """
    fine, rows = _refined(position, time_s, run, exponent)
    return relax(fine[0], fine[1], fine[2].astype(np.int64), tau_s)[rows]


def springpot(
    position: FloatArray, time_s: FloatArray, run: IntArray, exponent: float, alpha: float
) -> FloatArray:
    """What is left of max(x, 0)^n, shape (n,), as every step of it fades as (t / 1 s)^-alpha.

    t^-alpha is the sum of exponentials at all rates u with weights u^(alpha-1) / gamma(alpha). Those slower
    than the data are a spring, those faster than its samples a dashpot, and the others a ladder of them
    (R. Schapery, AIAA 1962; trapezoidal rule over log u).
    """
    (signal, times, number), rows = _refined(position, time_s, run, exponent)
    number = number.astype(np.int64)
    starts, _ = places(number)
    steps = np.diff(times, prepend=times[:1])
    steps[starts] = np.inf
    duration, shortest = float(np.ptp(times)), float(steps.min())
    if not 0.0 < shortest < np.inf:
        return np.zeros(len(position))
    lowest, highest = np.log(_SLOWEST / duration), np.log(_FASTEST / shortest)
    log_rates = np.arange(lowest, highest + _LADDER, _LADDER)
    rates, weights = np.exp(log_rates), _LADDER * np.exp(alpha * log_rates) / gamma(alpha)
    slower = weights[0] / np.expm1(alpha * _LADDER)
    faster = weights[-1] / rates[-1] / np.expm1((1.0 - alpha) * _LADDER)
    rise = np.diff(signal, prepend=signal[:1]) / steps
    left = slower * signal + faster * rise
    for rate, weight in zip(rates.tolist(), weights.tolist(), strict=True):
        left += weight * relax(signal, times, number, 1.0 / rate)
    return np.asarray(left[rows])


def _refined(
    position: FloatArray, time_s: FloatArray, run: IntArray, exponent: float
) -> tuple[FloatArray, IntArray]:
    """max(x, 0)^n, time and run (3, m) on steps in which the power goes straight, and where samples are."""
    change = np.abs(np.diff(position, prepend=position[:1]))
    change[places(run)[0]] = 0.0
    range_of_it = float(np.ptp(position)) or 1.0
    parts = np.clip(np.ceil(change / (_COARSE * range_of_it)), 1, _MOST_PARTS).astype(np.int64)
    if exponent == 1.0 or parts.max(initial=1) == 1:
        power = np.maximum(position, 0.0) ** exponent
        return np.stack([power, time_s, run.astype(np.float64)]), np.arange(len(position))
    rows = np.cumsum(parts) - 1
    sample = np.repeat(np.arange(len(position)), parts)
    left = (rows[sample] - np.arange(len(sample))) / parts[sample]  # of the way to the sample
    before = np.maximum(sample - 1, 0)
    fine = (1.0 - left) * position[sample] + left * np.where(left > 0.0, position[before], 0.0)
    times = (1.0 - left) * time_s[sample] + left * np.where(left > 0.0, time_s[before], 0.0)
    return np.stack([np.maximum(fine, 0.0) ** exponent, times, run[sample].astype(np.float64)]), rows
