"""Velocity and acceleration from positions, without phase error.

A cubic is fitted to the samples around each sample (local polynomial regression; A. Savitzky, M. J. E. Golay,
Analytical Chemistry 36 (1964) for even sampling, W. S. Cleveland, JASA 74 (1979) in general). Each piece of
the motion is taken by itself, so that nothing is smoothed from one run into the next. How many samples go
into a fit is found by cross-validation: as many as predict a left-out position nearly as well as the best
number does.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from robot_io.types import FloatArray, IntArray

DEGREE = 3
_HALF_WINDOWS = (2, 3, 4, 5, 7, 10, 14, 20, 28)
_TOLERANCE = 1.1  # a wider window is taken if it predicts at most 10 % worse: it calms the derivatives
_TRIALS = 4000  # samples on which windows are compared
_EVEN = 1e-4  # steps that differ by less, as a share of a step, count as even
_BLOCK = 20_000  # samples fitted at once, to bound memory


@dataclass(frozen=True)
class Motion:
    """Derivatives of a position.

    Attributes:
        velocity: shape (n,), unit of the position per second.
        acceleration: shape (n,).
        half_window: samples on either side that went into each fit.
    """

    velocity: FloatArray
    acceleration: FloatArray
    half_window: int


def differentiate(
    time_s: FloatArray, position: FloatArray, piece: IntArray, half_window: int | None = None
) -> Motion:
    """Velocity and acceleration of a sampled position.

    Args:
        time_s: shape (n,), strictly increasing within a piece [s].
        position: shape (n,).
        piece: shape (n,), the same number for samples that belong to one smooth motion; in one block each.
        half_window: samples on either side; None to find out.
    """
    pieces = list(_blocks(piece))
    half = _best_half_window(time_s, position, pieces) if half_window is None else half_window
    velocity, acceleration = np.zeros(len(position)), np.zeros(len(position))
    for rows in pieces:
        for first in range(rows.start, rows.stop, _BLOCK):
            centres = np.arange(first, min(first + _BLOCK, rows.stop)) - rows.start
            local = _local_fit(time_s[rows], position[rows], centres, half)
            velocity[rows][centres] = local.velocity
            acceleration[rows][centres] = local.acceleration
    return Motion(velocity, acceleration, half)


def centre_slope(half_window: int) -> FloatArray:
    """What turns 2 h + 1 evenly spaced samples into the slope per step in their middle, shape (2 h + 1,)."""
    slope: FloatArray = _even_coefficients(2 * half_window + 1, half_window)[1]
    return slope


def _blocks(piece: IntArray) -> Iterator[slice]:
    borders = [0, *(np.flatnonzero(np.diff(piece)) + 1).tolist(), len(piece)]
    for start, stop in pairwise(borders):
        if stop > start:
            yield slice(start, stop)


@dataclass(frozen=True)
class _LocalFit:
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    leverage: FloatArray  # share of each fitted position that is its own measurement


def _local_fit(time_s: FloatArray, position: FloatArray, centres: IntArray, half: int) -> _LocalFit:
    """Fit a polynomial around each of the samples `centres` of one piece."""
    width = min(2 * half + 1, len(position))
    starts = np.clip(centres - half, 0, len(position) - width)
    steps = np.diff(time_s)
    if len(steps) == 0 or np.ptp(steps) <= _EVEN * steps.max():
        step_s = float(np.mean(steps)) if len(steps) else 1.0
        return _even_fit(step_s, position, centres, starts, width)
    return _uneven_fit(time_s, position, centres, starts, width)


def _even_fit(
    step_s: float, position: FloatArray, centres: IntArray, starts: IntArray, width: int
) -> _LocalFit:
    """One set of coefficients for all samples in the middle of their window, one for each place at an end."""
    fitted: FloatArray = np.empty((len(centres), 3))
    leverage: FloatArray = np.empty(len(centres))
    windows = sliding_window_view(position, width)
    for place in np.unique(centres - starts):
        rows = centres - starts == place
        coefficients = _even_coefficients(width, int(place))
        fitted[rows] = windows[starts[rows]] @ coefficients.T
        leverage[rows] = coefficients[0, place]
    return _LocalFit(fitted[:, 0], fitted[:, 1] / step_s, 2 * fitted[:, 2] / step_s**2, leverage)


@lru_cache(maxsize=4096)
def _even_coefficients(width: int, place: int) -> FloatArray:
    """What turns a window into its polynomial's value, slope and half curvature at `place`, (3, width)."""
    basis = (np.arange(width) - place)[:, None] ** np.arange(min(DEGREE, width - 1) + 1.0)
    coefficients = np.zeros((3, width))
    fitted = np.linalg.pinv(basis)[:3]
    coefficients[: len(fitted)] = fitted
    coefficients.setflags(write=False)
    return coefficients


def _uneven_fit(
    time_s: FloatArray, position: FloatArray, centres: IntArray, starts: IntArray, width: int
) -> _LocalFit:
    """Normal equations of each window, summed up sample by sample over all windows at once."""
    terms = min(DEGREE, len(position) - 1) + 1
    unit = width / 2 * float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    moments, products = np.zeros((2 * terms - 1, len(centres))), np.zeros((terms, len(centres)))
    for offset in range(width):
        power = np.ones(len(centres))
        away = (time_s[starts + offset] - time_s[centres]) / unit
        value = position[starts + offset] - position[centres]
        for order in range(2 * terms - 1):
            moments[order] += power
            if order < terms:
                products[order] += power * value
            power = power * away
    matrix = moments[np.add.outer(np.arange(terms), np.arange(terms))].transpose(2, 0, 1)
    inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    fitted = np.zeros((len(centres), 3))
    fitted[:, : min(3, terms)] = np.einsum("nij,jn->ni", inverse, products)[:, :3]
    moved = position[centres] + fitted[:, 0]
    return _LocalFit(moved, fitted[:, 1] / unit, 2 * fitted[:, 2] / unit**2, inverse[:, 0, 0])


def _best_half_window(time_s: FloatArray, position: FloatArray, pieces: list[slice]) -> int:
    """The widest window whose left-out prediction is nearly the best."""
    smallest = 2 * _HALF_WINDOWS[0] + 1
    long_enough = [rows for rows in pieces if rows.stop - rows.start > smallest]
    if not long_enough:
        return _HALF_WINDOWS[0]
    longest = max(rows.stop - rows.start for rows in long_enough)
    halves = [half for half in _HALF_WINDOWS if 2 * half + 1 < longest or half == _HALF_WINDOWS[0]]
    stride = max(1, sum(rows.stop - rows.start for rows in long_enough) // _TRIALS)
    errors = [_left_out_error(time_s, position, long_enough, half, stride) for half in halves]
    limit = _TOLERANCE * min(errors)
    return max(half for half, error in zip(halves, errors, strict=True) if error <= limit)


def _left_out_error(
    time_s: FloatArray, position: FloatArray, pieces: list[slice], half: int, stride: int
) -> float:
    """Root mean square error of predicting a sample from its neighbours, on every `stride`-th sample."""
    squares = []
    for rows in pieces:
        centres = np.arange(0, rows.stop - rows.start, stride)
        local = _local_fit(time_s[rows], position[rows], centres, half)
        missed = (position[rows][centres] - local.position) / np.maximum(1 - local.leverage, 1e-3)
        squares.append(missed**2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))
