"""Efforts that fade without a scale of time."""

import numpy as np
from scipy.special import gamma

from estimation.signals.blocks import places
from estimation.signals.fading import faded
from robot_io.types import FloatArray, IntArray

_LADDER = 1.4  # between the logarithms of two rates: five in three decades miss by less than 1e-3
_SLOWEST, _FASTEST = 1e-2, 10.0  # rates, times the whole duration and times the shortest step


def springpot(signal: FloatArray, time_s: FloatArray, run: IntArray, alpha: float) -> FloatArray:
    """What is left of signals (n,) or (n, k) as every step of them fades as (t / 1 s)^-alpha.

    t^-alpha is the sum of exponentials at all rates u with weights u^(alpha-1) / gamma(alpha). Those slower
    than the data are a spring, those faster than its samples a dashpot, and the others a ladder of them, each
    exact between samples at any times (trapezoidal rule over log u).
    """
    steps = np.diff(time_s, prepend=time_s[:1])
    steps[places(run)[0]] = np.inf
    shortest = float(steps.min(initial=np.inf))
    if not 0.0 < shortest < np.inf:
        return np.zeros(signal.shape)
    lowest, highest = np.log(_SLOWEST / np.ptp(time_s)), np.log(_FASTEST / shortest)
    rates = np.exp(np.arange(lowest, highest + _LADDER, _LADDER))
    weights = _LADDER * rates**alpha / gamma(alpha)
    slower = weights[0] / np.expm1(alpha * _LADDER)
    faster = weights[-1] / rates[-1] / np.expm1((1.0 - alpha) * _LADDER)
    slopes = np.diff(signal, axis=0, prepend=signal[:1]) / steps.reshape(-1, *([1] * (signal.ndim - 1)))
    return np.asarray(slower * signal + faster * slopes + faded(signal, time_s, run, rates, weights))
