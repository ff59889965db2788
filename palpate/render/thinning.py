"""Thin curves, so that a browser draws them quickly and every peak remains visible."""

from collections.abc import Sequence

import numpy as np

from palpate.robot_io.types import FloatArray, IntArray

MOST_POINTS = 4000
_MOST_RUNS = 60
_FEWEST = 16  # smallest number of points of a run


def peak_rows(values: FloatArray, most: int = MOST_POINTS) -> IntArray:
    """Return rows of `values` to draw: minimum and maximum of each of `most` / 2 equal intervals.

    An interval without finite values keeps one row, which leaves a gap in the curve.

    Args:
        values: shape (n,).
        most: number of rows to keep.
    """
    n = len(values)
    if n <= most:
        return np.arange(n)
    width = -(-n // (most // 2))
    padded = np.full(-(-n // width) * width, np.nan)
    padded[:n] = values
    stretches = padded.reshape(-1, width)
    first = np.arange(len(stretches)) * width
    lows = first + np.where(np.isfinite(stretches), stretches, np.inf).argmin(axis=1)
    highs = first + np.where(np.isfinite(stretches), stretches, -np.inf).argmax(axis=1)
    return np.unique(np.concatenate([lows, highs, [0, n - 1]]))


def even_places(count: int, most: int) -> IntArray:
    """Return places from 0 to `count` - 1 at even distances, with the first and the last, shape (k,).

    Args:
        count: number of places, at least 1.
        most: largest number k, at least 2; fewer if there are fewer places.
    """
    return np.unique(np.linspace(0, count - 1, most).astype(int))


def rows_by_run(run: IntArray) -> dict[int, IntArray]:
    """Return the rows of each run by its number; if there are very many runs, an even selection of them.

    Args:
        run: number of each sample's run, shape (n,).
    """
    numbers = np.unique(run)
    places = np.linspace(0, len(numbers) - 1, min(len(numbers), _MOST_RUNS))
    chosen = numbers[np.unique(places.round().astype(int))]
    return {number: np.flatnonzero(run == number) for number in chosen.tolist()}


def run_curves(x: FloatArray, y: FloatArray, runs: Sequence[IntArray]) -> list[tuple[FloatArray, FloatArray]]:
    """Return each run's curve (x, y), thinned so that peaks of both coordinates remain.

    Args:
        x: shape (n,).
        y: shape (n,).
        runs: rows of each run.
    """
    share = max(MOST_POINTS // (2 * max(len(runs), 1)), _FEWEST)
    kept = (rows[np.union1d(peak_rows(x[rows], share), peak_rows(y[rows], share))] for rows in runs)
    return [(x[rows], y[rows]) for rows in kept]


def join_curves(curves: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Join curves into one, with a gap (NaN) after each.

    Args:
        curves: x and y of each.
    """
    gap = np.array([np.nan])
    x, y = ([part for curve in curves for part in (curve[axis], gap)] for axis in (0, 1))
    return (np.concatenate(x), np.concatenate(y)) if curves else (gap, gap)
