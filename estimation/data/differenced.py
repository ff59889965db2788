"""Whether a file's velocity was measured, or is a difference of its positions."""

from collections.abc import Iterator

import numpy as np

from estimation.signals.blocks import blocks
from robot_io.types import FloatArray, IntArray

_HALVES = (1, 2, 3, 4, 5, 8, 10, 16, 32)  # samples to either side of a central difference
_REACHES = (*((half, half) for half in _HALVES), (1, 0), (0, 1))  # and the backward and forward ones
_SAME = 0.5  # of the energy of a difference's noise, that the given velocity may differ from it by


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
    return any(
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
