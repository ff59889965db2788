"""The stretches of samples that belong together."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from estimation.signals.cache_by_array import of_arrays
from robot_io.types import BoolArray, FloatArray, IntArray

_GAP = 3.5  # median steps that are a gap: jitter, and a sample or two that were lost, are none


def blocks(number: IntArray | BoolArray) -> Iterator[slice]:
    """The rows of each stretch of equal numbers, in their order; none of no rows.

    Args:
        number: of the run, piece or phase that each sample belongs to, or a mask, shape (n,).
    """
    borders = [0, *(np.flatnonzero(number[1:] != number[:-1]) + 1).tolist(), len(number)]
    for start, stop in pairwise(borders):
        if stop > start:
            yield slice(start, stop)


@of_arrays
def places(number: IntArray | BoolArray) -> tuple[IntArray, IntArray]:
    """First row of each stretch of equal numbers, and to which stretch each row belongs, shape (n,)."""
    changes = np.ones(len(number), dtype=np.bool_)
    np.not_equal(number[1:], number[:-1], out=changes[1:])
    starts, piece = np.flatnonzero(changes), np.cumsum(changes) - 1
    piece.setflags(write=False)  # it is remembered
    starts.setflags(write=False)
    return starts, piece


def number_pieces(time_s: FloatArray, run: IntArray) -> IntArray:
    """Numbers, from 0, of the stretches that end with a run or at a gap in time [s], shape (n,).

    A gap is longer than the steps on either side of it, too: where a rate falls for good, there is none.

    A touch ends none. It bends the velocity but does not break it, and a window across it is less wrong than
    the lopsided windows at the ends of two pieces would be (see docs/estimation.md).
    """
    steps_s, same_run = np.diff(time_s), np.diff(run) == 0
    border = ~same_run
    if same_run.any():
        beside = np.pad(np.where(same_run, steps_s, 0.0), 1)
        usual = np.maximum(np.median(steps_s[same_run]), np.maximum(beside[:-2], beside[2:]))
        border = border | (steps_s > _GAP * usual)
    return np.concatenate([[0], np.cumsum(border)]).astype(np.int64)


def of_equal_length(number: IntArray) -> Iterator[IntArray]:
    """The rows of all stretches of one length, shape (stretches, length), length by length."""
    first, _ = places(number)
    lengths = np.diff(first, append=len(number))
    for length in np.unique(lengths):
        yield first[lengths == length][:, None] + np.arange(length)


def rows_of_runs(run: IntArray) -> list[IntArray]:
    """The rows of each run in ascending order of their numbers, in one go: there may be thousands of runs."""
    order = np.argsort(run, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(run[order])) + 1)


@of_arrays
def in_order_of_time(time_s: FloatArray, run: IntArray) -> list[slice]:
    """The rows of each run, the earliest first, whatever their numbers are.

    Where runs overlap in time, each has a clock of its own, and they stay in their order.

    Args:
        time_s: shape (n,), increasing within a run [s].
        run: shape (n,), one block of samples for each run.
    """
    numbered = list(blocks(run))
    sorted_rows = sorted(numbered, key=lambda rows: float(time_s[rows.start]))
    apart = all(time_s[one.stop - 1] <= time_s[two.start] for one, two in pairwise(sorted_rows))
    return sorted_rows if apart else numbered


def cut(signal: FloatArray, length: int) -> FloatArray:
    """The signal (n,) or (n, k) cut into pieces of equal length, (length, pieces) or (..., k).

    The last one is filled up with the last sample.
    """
    count = -(-len(signal) // length)
    filled = np.concatenate([signal, np.repeat(signal[-1:], count * length - len(signal), axis=0)])
    cut: FloatArray = filled.reshape(count, length, *signal.shape[1:]).swapaxes(0, 1)
    return np.ascontiguousarray(cut)


def stretches(mask: BoolArray, number: IntArray) -> IntArray:
    """Numbers, shape (n,), that change wherever the mask or the number of the run changes."""
    changes = (np.diff(mask) != 0) | (np.diff(number) != 0)
    return np.concatenate([[0], np.cumsum(changes)])[: len(mask)]


def since_their_start(time_s: FloatArray, run: IntArray) -> FloatArray:
    """Times [s] (n,) on a clock that begins anew with each run."""
    begun_s = time_s.copy()
    for rows in blocks(run):
        begun_s[rows] -= time_s[rows.start]
    return begun_s
