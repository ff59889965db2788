"""Divide samples into blocks such as runs, pieces without gaps, and phases."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from palpate.estimation.signals.cache_by_array import cache_by_array
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_MIN_GAP = 3.5  # least gap in median steps; jitter and one or two lost samples cause shorter gaps


def blocks(number: IntArray | BoolArray) -> Iterator[slice]:
    """Iterate over the rows of each block of equal numbers, in order.

    Args:
        number: number of the run, piece or phase that each sample belongs to, or a mask, shape (n,).
    """
    borders = [0, *(np.flatnonzero(number[1:] != number[:-1]) + 1).tolist(), len(number)]
    for start, stop in pairwise(borders):
        if stop > start:
            yield slice(start, stop)


@cache_by_array
def block_index(number: IntArray | BoolArray) -> tuple[IntArray, IntArray]:
    """Find the blocks of equal numbers.

    Args:
        number: number of the run, piece or phase that each sample belongs to, or a mask, shape (n,).

    Returns:
        First row of each block, shape (blocks,), and the block of each row, shape (n,).
    """
    changes = np.ones(len(number), dtype=np.bool_)
    np.not_equal(number[1:], number[:-1], out=changes[1:])
    starts, piece = np.flatnonzero(changes), np.cumsum(changes) - 1
    piece.setflags(write=False)  # both results are cached
    starts.setflags(write=False)
    return starts, piece


def number_pieces(time_s: FloatArray, run: IntArray) -> IntArray:
    """Number the pieces of a recording, which end with a run or at a gap in time.

    A gap must exceed the steps on both sides, so that a permanent drop of the sampling rate is not a gap. A
    piece does not end at the start of a contact, where the velocity changes without a jump: a smoothing
    window across it has less error than one-sided windows (see docs/explanation/estimation.md).

    Args:
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).

    Returns:
        Number of each sample's piece, from 0, shape (n,).
    """
    steps_s, same_run = np.diff(time_s), np.diff(run) == 0
    border = ~same_run
    if same_run.any():
        beside_s = np.pad(np.where(same_run, steps_s, 0.0), 1)
        typical_s = np.maximum(np.median(steps_s[same_run]), np.maximum(beside_s[:-2], beside_s[2:]))
        border = border | (steps_s > _MIN_GAP * typical_s)
    return np.concatenate([[0], np.cumsum(border)]).astype(np.int64)


def equal_length_blocks(number: IntArray) -> Iterator[IntArray]:
    """Iterate over groups of blocks with equal length, the shortest first.

    Args:
        number: number of the run, piece or phase that each sample belongs to, shape (n,).

    Yields:
        Rows of all blocks of one length, shape (blocks, length).
    """
    first, _ = block_index(number)
    lengths = np.diff(first, append=len(number))
    for length in np.unique(lengths):
        yield first[lengths == length][:, None] + np.arange(length)


def rows_of_runs(run: IntArray) -> list[IntArray]:
    """Return the rows of each run, in ascending order of run numbers.

    Args:
        run: run of each sample, shape (n,).
    """
    order = np.argsort(run, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(run[order])) + 1)


@cache_by_array
def runs_by_time(time_s: FloatArray, run: IntArray) -> list[slice]:
    """Return the rows of each run, the earliest run first.

    If runs overlap in time, they have separate clocks, and the order of the rows is kept.

    Args:
        time_s: times, increasing within a run, shape (n,) [s].
        run: run number of each sample, in one block for each run, shape (n,).
    """
    runs = list(blocks(run))
    sorted_rows = sorted(runs, key=lambda rows: float(time_s[rows.start]))
    return sorted_rows if has_one_clock(time_s, run) else runs


def has_one_clock(time_s: FloatArray, run: IntArray) -> bool:
    """Return whether runs do not overlap in time, as they would with separate clocks.

    Args:
        time_s: times, increasing within a run, shape (n,) [s].
        run: run number of each sample, in one block for each run, shape (n,).
    """
    spans_s = sorted((float(time_s[rows.start]), float(time_s[rows.stop - 1])) for rows in blocks(run))
    return all(end_s <= start_s for (_, end_s), (start_s, _) in pairwise(spans_s))


def split_columns(signal: FloatArray, length: int) -> FloatArray:
    """Split a signal into pieces of equal length, one per column; the last sample pads the last piece.

    Args:
        signal: signal, shape (n,) or (n, k).
        length: number of samples in a piece.

    Returns:
        Contiguous array, shape (length, pieces) or (length, pieces, k).
    """
    count = -(-len(signal) // length)
    padded = np.concatenate([signal, np.repeat(signal[-1:], count * length - len(signal), axis=0)])
    pieces: FloatArray = padded.reshape(count, length, *signal.shape[1:]).swapaxes(0, 1)
    return np.ascontiguousarray(pieces)


def number_stretches(mask: BoolArray, number: IntArray) -> IntArray:
    """Number the blocks in which neither a mask nor the run changes.

    Args:
        mask: mask of samples, such as those in contact, shape (n,).
        number: run number of each sample, shape (n,).

    Returns:
        Number of each sample's block, from 0, shape (n,).
    """
    return block_index(2 * block_index(number)[1] + mask)[1]


def since_start(signal: FloatArray, run: IntArray) -> FloatArray:
    """Return a signal, such as the time, minus its first value in each sample's run, shape (n,).

    Args:
        signal: times or another signal, shape (n,).
        run: run of each sample, in one block for each run, shape (n,).
    """
    changed = signal.copy()
    for rows in blocks(run):
        changed[rows] -= signal[rows.start]
    return changed
