"""Cuts one recording of several presses into runs, so that whole ones can be held out."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from estimation.signals.blocks import blocks
from robot_io.errors import InputError
from robot_io.types import FloatArray, IntArray

FEWEST_ROWS = 20  # of a run that nobody named: a press that is cut out, or a block of equal numbers
_MOST_RUNS = 500  # that presses are cut into: of more, several are one run
# of the usual range of the force: a press goes from below the one above the other
_PRESSED, _RELEASED = 0.1, 0.05
_SIGMAS = (8.0, 4.0)  # the same in deviations of the noise, whichever is more
_TO_SIGMA = 1.4826 / np.sqrt(2.0)  # from the median step between neighbours, for normal noise
_FEW = 0.02  # of the samples: fewer in free air tell no baseline
_AIR = 0.1  # of the lower of two presses, that the force between them may be above its lowest


@dataclass(frozen=True)
class Levels:
    """Forces [N] that tell a press from free air."""

    pressed: float  # above it something is pressed
    released: float  # below it nothing is
    free: float  # in free air


def force_levels(force: FloatArray, displacement: FloatArray) -> Levels:
    """The levels of a contact's force, shape (n,), beside its displacement, shape (n,)."""
    outside = displacement <= 0.0
    free = force[outside] if np.mean(outside) > _FEW else force
    base = float(np.median(free) if free is not force else np.quantile(force, _FEW))
    span = float(np.quantile(force, 0.98)) - base
    noise = _TO_SIGMA * float(np.median(np.abs(np.diff(force)))) if len(force) > 1 else 0.0
    return Levels(
        base + max(_PRESSED * span, min(_SIGMAS[0] * noise, 0.5 * span)),
        base + max(_RELEASED * span, min(_SIGMAS[1] * noise, 0.25 * span)),
        base,
    )


def restarts(time_s: FloatArray) -> IntArray:
    """Number of each row's recording, shape (n,), where a clock begins anew; else all 0.

    Args:
        time_s: shape (n,), in the order of the file [s].
    """
    back = np.flatnonzero(np.diff(time_s) < 0.0) + 1
    if not len(back):
        return np.zeros(len(time_s), dtype=np.int64)
    step_s = float(np.median(np.diff(time_s)))
    anew = np.abs(time_s[back] - time_s[0]) <= 2.0 * max(step_s, 0.0)
    number = np.zeros(len(time_s), dtype=np.int64)
    number[back] = 1
    return np.cumsum(number) if anew.all() else np.zeros(len(time_s), dtype=np.int64)


def cut_presses(force: FloatArray, displacement: FloatArray, piece: IntArray) -> tuple[IntArray, int]:
    """Number of each row's run, shape (n,), from the middle of one free air to another, and presses in each.

    Args:
        force: shape (n,), positive in compression.
        displacement: shape (n,), positive into the object.
        piece: recordings that are apart already, shape (n,).
    """
    levels = force_levels(force, displacement)
    tops = np.concatenate([_tops(force[rows], levels) + rows.start for rows in blocks(piece)])
    presses = max(1, -(-len(tops) // _MOST_RUNS))
    return _cut(force, piece, tops.astype(np.int64), FEWEST_ROWS, presses), presses


def cut_into(
    force: FloatArray, displacement: FloatArray, piece: IntArray, count: int, where: str
) -> IntArray:
    """Number of each row's run, shape (n,), if there are so many: the presses that come from furthest out.

    Raises:
        InputError: there are fewer presses.
    """
    from scipy.signal import find_peaks, peak_prominences  # noqa: PLC0415, slow to import

    depth = np.asarray(scipy.ndimage.median_filter(displacement, 5))
    padded = np.pad(depth, 1, constant_values=depth.min())
    peaks = find_peaks(padded)[0]
    way = peak_prominences(padded, peaks)[0]
    pressed = (
        np.asarray(scipy.ndimage.median_filter(force, 5))[peaks - 1]
        > force_levels(force, displacement).released
    )
    is_press = pressed & (way > _RELEASED * np.ptp(depth))
    tops = np.sort(peaks[is_press][np.argsort(way[is_press])[::-1][:count]]) - 1
    run = _cut(force, piece, tops, 1) if len(tops) else piece
    if run[-1] + 1 != count:
        presses = f"{run[-1] + 1} press{'es' if run[-1] else ''}"
        raise InputError(f"{where}: {presses} can be told apart at most")
    return run


def _tops(force: FloatArray, levels: Levels) -> IntArray:
    """Row of the largest force of each press."""
    sides = np.where(force > levels.pressed, 1, np.where(force < levels.released, -1, 0))
    met = np.flatnonzero(sides)
    if not len(met):
        return np.zeros(0, dtype=np.int64)
    begins = met[np.flatnonzero((sides[met] > 0) & np.append(True, sides[met][:-1] < 0))]
    ends = np.append(begins, len(force))[1:]
    return np.array(
        [a + int(np.argmax(force[a:b])) for a, b in zip(begins, ends, strict=True)], dtype=np.int64
    )


def _cut(force: FloatArray, piece: IntArray, tops: IntArray, fewest: int, presses: int = 1) -> IntArray:
    border = np.zeros(len(force), dtype=np.int64)
    border[1:] = np.diff(piece) != 0
    for one, two in list(pairwise(tops.tolist()))[presses - 1 :: presses]:
        if piece[one] == piece[two]:
            border[_between(force, one, two)] = 1
    run = np.cumsum(border)
    counts = np.bincount(run)
    return run if counts.min() >= fewest else piece


def _between(force: FloatArray, one: int, two: int) -> int:
    """The middle of the free air between two presses."""
    stretch = force[one:two]
    low = float(stretch.min())
    free = np.flatnonzero(stretch <= low + _AIR * max(min(force[one], force[two]) - low, 0.0))
    return one + int(free[0] + free[-1] + 1) // 2
