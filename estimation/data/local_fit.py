"""Polynomials fitted to the samples around each sample.

A. Savitzky, M. J. E. Golay, Analytical Chemistry 36 (1964) for even sampling, W. S. Cleveland, JASA 74 (1979)
in general.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import factorial

import numpy as np
import scipy

from robot_io.types import FloatArray, IntArray

DEGREE = 3
_EVEN = 1e-4  # steps that differ by less, as a share of a step, count as even


@dataclass(frozen=True)
class LocalFit:
    """Fits around n samples."""

    fitted: FloatArray  # position, velocity and acceleration, shape (n, 3)
    # Of each of them for noise of variance 1, shape (n, 3); that of a
    # position is also the share of its own measurement in it.
    variance: FloatArray


def local_fit(time_s: FloatArray, position: FloatArray, centres: IntArray, half: int) -> LocalFit:
    """Fit a polynomial around each of the samples `centres` of one piece."""
    width = min(2 * half + 1, len(position))
    starts = np.clip(centres - half, 0, len(position) - width)
    steps = np.diff(time_s)
    if len(steps) == 0 or np.ptp(steps) <= _EVEN * steps.max():
        step_s = float(np.mean(steps)) if len(steps) else 1.0
        return _even_fit(step_s, position, centres, starts, width)
    return _uneven_fit(time_s, position, centres, starts, width)


def local_fits(
    time_s: FloatArray, position: FloatArray, pieces: Sequence[slice], centres: Sequence[IntArray], half: int
) -> LocalFit:
    """The same for several pieces, one after the other; centres are counted from the start of each."""
    width, chosen = 2 * half + 1, list(zip(pieces, centres, strict=True))
    steps = np.concatenate([np.diff(time_s[rows]) for rows in pieces])
    if np.ptp(steps) <= _EVEN * steps.max() and min(rows.stop - rows.start for rows in pieces) >= width:
        starts = [np.clip(one + rows.start - half, rows.start, rows.stop - width) for rows, one in chosen]
        around = np.concatenate([rows.start + one for rows, one in chosen])
        return _even_fit(float(np.mean(steps)), position, around, np.concatenate(starts), width)
    fits = [local_fit(time_s[rows], position[rows], one, half) for rows, one in chosen]
    fitted, variance = zip(*((one.fitted, one.variance) for one in fits), strict=True)
    return LocalFit(np.concatenate(fitted), np.concatenate(variance))


def local_derivative(time_s: FloatArray, signal: FloatArray, half: int, order: int) -> FloatArray:
    """Derivative (n,) of a signal (n,) of one piece from such fits around all samples; see `local_fit`."""
    width, steps = 2 * half + 1, np.diff(time_s)
    if len(signal) < width or np.ptp(steps) > _EVEN * steps.max():
        return local_fit(time_s, signal, np.arange(len(signal)), half).fitted[:, order]
    by_place = _at_each_place(width)[:, order] * factorial(order) / float(np.mean(steps)) ** order
    middle = np.correlate(signal, by_place[half])
    return np.concatenate([by_place[:half] @ signal[:width], middle, by_place[half + 1 :] @ signal[-width:]])


def uneven_derivative_operator(time_s: FloatArray, half: int, order: int) -> "scipy.sparse.csr_array":
    """Matrix (n, n) that turns a signal of one piece into what `local_derivative` makes of it.

    Args:
        time_s: times [s], shape (n,), at any steps.
        half: samples to either side of each, that a polynomial is fitted to.
        order: of the derivative, 0 to 2.
    """
    count, width = len(time_s), min(2 * half + 1, len(time_s))
    terms = min(DEGREE, count - 1) + 1
    if order >= terms:
        return scipy.sparse.csr_array((count, count))
    rows = np.clip(np.arange(count) - half, 0, count - width)[:, None] + np.arange(width)
    unit = width / 2 * float(time_s[-1] - time_s[0]) / max(count - 1, 1) or 1.0
    powers = ((time_s[rows] - time_s[:, None]) / unit)[..., None] ** np.arange(terms)
    inverse = _inverse(np.einsum("nwi,nwj->nij", powers, powers))
    weights = np.einsum("nwj,nj->nw", powers, inverse[:, order]) * factorial(order) / unit**order
    ends = np.arange(0, rows.size + 1, width)
    return scipy.sparse.csr_array((weights.ravel(), rows.ravel(), ends), shape=(count, count))


def _even_fit(
    step_s: float, position: FloatArray, centres: IntArray, starts: IntArray, width: int
) -> LocalFit:
    """One set of coefficients for all samples in the middle of their window, one for each place at an end."""
    place = centres - starts
    middle = even_coefficients(width, width // 2)
    fitted = np.array([np.correlate(position, one)[starts] for one in middle]).T
    variance = np.tile(np.sum(middle**2, axis=1), (len(centres), 1))
    ends = np.flatnonzero(place != width // 2)
    coefficients = _at_each_place(width)[place[ends]]
    windows = position[starts[ends, None] + np.arange(width)]
    fitted[ends] = np.einsum("nkw,nw->nk", coefficients, windows)
    variance[ends] = np.sum(coefficients**2, axis=2)
    per_second = np.array([1.0, 1 / step_s, 2 / step_s**2])
    return LocalFit(fitted * per_second, variance * per_second**2)


@lru_cache(maxsize=4096)
def even_coefficients(width: int, place: int) -> FloatArray:
    """What turns a window into its polynomial's value, slope and half curvature at `place`, (3, width)."""
    basis = (np.arange(width) - place)[:, None] ** np.arange(min(DEGREE, width - 1) + 1.0)
    coefficients = np.zeros((3, width))
    fitted = np.linalg.pinv(basis)[:3]
    coefficients[: len(fitted)] = fitted
    coefficients.setflags(write=False)
    return coefficients


@lru_cache(maxsize=64)
def _at_each_place(width: int) -> FloatArray:
    """The same for all places of a window, shape (width, 3, width)."""
    return np.array([even_coefficients(width, place) for place in range(width)])


def _uneven_fit(
    time_s: FloatArray, position: FloatArray, centres: IntArray, starts: IntArray, width: int
) -> LocalFit:
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
    inverse = _inverse(matrix)
    fitted, variance = np.zeros((len(centres), 3)), np.zeros((len(centres), 3))
    fitted[:, : min(3, terms)] = np.einsum("nij,jn->ni", inverse, products)[:, :3]
    fitted[:, 0] += position[centres]
    variance[:, : min(3, terms)] = np.einsum("nii->ni", inverse)[:, :3]
    per_second = np.array([1.0, 1 / unit, 2 / unit**2])
    return LocalFit(fitted * per_second, variance * per_second**2)


def _inverse(matrix: FloatArray) -> FloatArray:
    """Of each symmetric matrix (n, k, k); where times repeat, so that one has none, that of least norm."""
    try:
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrix, hermitian=True), dtype=np.float64)
