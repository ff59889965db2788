"""Whether a given velocity fits its position, and whether it was measured or is a difference of positions.

All of it holds for an acceleration beside its velocity too.
"""

from collections.abc import Iterator

import numpy as np

from estimation.signals.blocks import block_index, blocks
from estimation.statistics.correlation import correlation_coefficient
from robot_io.types import FloatArray, IntArray

_SAME_SHAPE = 0.7  # correlation, half of the variance: it is this position's velocity, whatever its scale
_OTHER_SCALE = 1.5  # smoothing takes less than a third off a velocity; a mistaken unit is off by ten and more
_WAYS = tuple(2**power for power in range(12))  # samples, that a way may take
_LEAST_WAYS = 0.5  # of the samples, at which a way must begin
_HALVES = (1, 2, 3, 4, 5, 8, 10, 16, 32)  # samples to either side of a central difference
_REACHES = (*((half, half) for half in _HALVES), (1, 0), (0, 1))  # and the backward and forward ones
_SAME = 0.5  # of the energy of a difference's noise, that the given velocity may differ from it by


def mistaken_scale(
    time_s: FloatArray, position: FloatArray, velocity: FloatArray, run: IntArray
) -> float | None:
    """How many times the slope of the position a given velocity is, where that is not one; else None.

    Compared are ways, as two positions have them and as the velocity leads in between, over the time that
    makes them most alike: long enough for steps and noise of a position to count little, and short enough for
    what integration adds up of a velocity's error. A joint at rest says nothing.

    Args:
        time_s: shape (n,) [s].
        position: shape (n,).
        velocity: as it is given, shape (n,).
        run: of each sample, shape (n,).
    """
    steps_s, piece = np.diff(time_s), block_index(run)[1]
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    led = np.concatenate([[0.0], np.cumsum(np.where(np.diff(piece) == 0, mean * steps_s, 0.0))])
    best, ratio = 0.0, 1.0
    for samples in _WAYS:
        same = piece[samples:] == piece[:-samples]
        if np.sum(same) < _LEAST_WAYS * len(position):
            break
        moved, by_velocity = ((x[samples:] - x[:-samples])[same] for x in (position, led))
        alike = correlation_coefficient(moved, by_velocity)
        if abs(alike) > best:
            best, ratio = abs(alike), float(by_velocity @ by_velocity) / float(moved @ by_velocity)
    is_mistaken = best > _SAME_SHAPE and not 1.0 / _OTHER_SCALE < ratio < _OTHER_SCALE
    return ratio if is_mistaken else None


def is_difference(
    time_s: FloatArray, position: FloatArray, given: FloatArray, calm: FloatArray, run: IntArray
) -> bool:
    """Whether a derivative has the very noise that a difference of the positions has.

    Such a column measures nothing that the positions do not say, and is noisier than need be: a central
    difference (`numpy.gradient` and kin) passes on the errors of two readings.

    Args:
        time_s: shape (n,) [s].
        position: shape (n,), or another signal.
        given: its derivative as the file has it, shape (n,).
        calm: its derivative by windows as wide as the motion allows, shape (n,).
        run: of each sample, shape (n,).
    """
    return bool(np.ptp(given) > 0.0) and any(  # a joint that rests has no difference
        float(np.mean((difference - given) ** 2)) < _SAME * float(np.mean((difference - calm) ** 2))
        for difference in _differences(time_s, position, run)
    )


def _differences(time_s: FloatArray, position: FloatArray, run: IntArray) -> Iterator[FloatArray]:
    """Differences of each run as many derive a velocity, shorter at its ends, shape (n,) each."""
    at = np.arange(len(position))
    first, last = np.empty_like(at), np.empty_like(at)
    for rows in blocks(run):
        first[rows], last[rows] = rows.start, rows.stop - 1
    for back, ahead in _REACHES:
        before, after = np.maximum(at - back, first), np.minimum(at + ahead, last)
        apart_s = time_s[after] - time_s[before]
        moved = position[after] - position[before]
        yield np.divide(moved, apart_s, out=np.zeros_like(moved), where=apart_s > 0.0)
