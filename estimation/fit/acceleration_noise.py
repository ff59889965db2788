"""How wrong the acceleration is, judged by the positions that it was derived from.

An acceleration derived from an encoder is smoothed. Smoothing cuts its peaks and leaves noise in it: a mass
fitted to it is too large or too small, by the same share in every run, and no residual shows that (W. A.
Fuller, Measurement Error Models (1987)). But integrated twice, it must lead along the measured positions.
"""

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.signals.blocks import blocks
from palpate.estimation.signals.runwise import shifted_motion
from palpate.robot_io.types import FloatArray

_REACH_S = 0.03  # to either side, that positions are compared over: noise of an encoder counts little there
_LEAST = 3  # samples


def inflate_acceleration_noise(data: ChannelData, reach_s: float = _REACH_S) -> ChannelData:
    """The channel with the acceleration that its positions speak for, on the average over a reach.

    What is missing in the acceleration is the second difference of the positions less those that it
    integrates to; over uneven times too. Ends of runs are left as they are.

    Args:
        data: the channel.
        reach_s: time to either side [s] that positions are compared over.
    """
    missing = np.zeros(len(data))
    for rows in blocks(data.run):
        missing[rows] = _missing(
            data.time_s[rows], data.position[rows], data.velocity[rows], data.acceleration[rows], reach_s
        )
    still = np.zeros(len(data))
    return shifted_motion(data, still, still, missing)


def _missing(time_s: FloatArray, x: FloatArray, v: FloatArray, a: FloatArray, reach_s: float) -> FloatArray:
    """Second difference of positions (n,) less those that an acceleration (n,) leads along."""
    missing = np.zeros(len(x))
    if len(x) < 2:
        return missing
    steps = np.diff(time_s)
    reach = max(int(reach_s / float(np.median(steps)) + 0.5), _LEAST)
    if len(x) <= 2 * reach:
        return missing
    off = x - _integral(v[0] + _integral(a, steps), steps)
    before, here, after = off[: -2 * reach], off[reach:-reach], off[2 * reach :]
    back = time_s[reach:-reach] - time_s[: -2 * reach]
    ahead = time_s[2 * reach :] - time_s[reach:-reach]
    missing[reach:-reach] = 2.0 * ((after - here) / ahead - (here - before) / back) / (ahead + back)
    return missing


def _integral(signal: FloatArray, steps: FloatArray) -> FloatArray:
    """Trapezoidal integral (n,) of a signal (n,), from zero."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (signal[1:] + signal[:-1]) * steps)])
