"""Null distribution of the best candidate's improvement (max-statistic permutation test).

Surrogate residuals keep distribution and autocorrelation but are independent of the motion: the residuals of
each run are shifted in time, with a random sign (J. Theiler et al., Physica D 58 (1992)). The observed
improvement is compared with the largest one over all candidates and their inner parameters (P. H. Westfall,
S. S. Young, Resampling-Based Multiple Testing (1993)).
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from palpate.robot_io.types import FloatArray, IntArray

COUNT = 199


def null_improvements(
    noise: FloatArray,
    run: IntArray,
    base: FloatArray,
    candidates: Iterable[FloatArray],
    rng: np.random.Generator,
    *,
    observed: float = np.inf,
    most: int = COUNT,
) -> FloatArray:
    """Compute the largest improvement by any candidate on surrogates of the noise.

    The loop over candidates ends early when more than `most` surrogates reach the observed improvement.

    Args:
        noise: residuals of the best model, in order of time within each run, shape (w,).
        run: run number of each residual, shape (w,).
        base: columns of the model without a candidate, shape (w, q).
        candidates: columns of the model with each candidate, shape (w, q') each.
        rng: random generator for the surrogates.
        observed: improvement by the best candidate on the data.
        most: largest number of surrogates that may reach it.

    Returns:
        For each surrogate, the largest share of its error that a candidate explains, shape (COUNT,).
    """
    surrogates = surrogate_residuals(noise, run, rng).astype(np.float32, order="C")
    explained = _explained(surrogates, base)
    residual = np.sum(surrogates**2, axis=0) - explained
    best = np.zeros(surrogates.shape[1])
    for columns in candidates:
        best = np.maximum(best, (_explained(surrogates, columns) - explained) / residual)
        if np.sum(best >= observed) > most:
            break
    return best


def surrogate_residuals(noise: FloatArray, run: IntArray, rng: np.random.Generator) -> FloatArray:
    """Generate surrogates of the noise by random shifts in time and random signs, shape (w, COUNT).

    Args:
        noise: residuals, shape (w,).
        run: run number of each residual, shape (w,).
        rng: random generator for the surrogates.
    """
    surrogates = np.empty((COUNT, len(noise)))
    for number in np.unique(run):
        rows = np.flatnonzero(run == number)
        shifts, signs = rng.integers(0, len(rows), COUNT), rng.choice([-1.0, 1.0], COUNT)
        shifted = np.lib.stride_tricks.sliding_window_view(np.tile(noise[rows], 2), len(rows))
        surrogates[:, rows] = shifted[shifts] * signs[:, None]
    return surrogates.T


def _explained(noise: NDArray[np.float32], columns: FloatArray) -> FloatArray:
    """Return the sum of squares of each surrogate (w, s) within the span of columns (w, q), shape (s,)."""
    if columns.shape[1] == 0:
        return np.zeros(noise.shape[1])
    lengths = np.sqrt(np.sum(columns**2, axis=0))
    unit = columns / np.where(lengths > 0.0, lengths, 1.0)
    squares, directions = np.linalg.eigh(unit.T @ unit)  # far faster than a singular value decomposition
    independent = squares > 1e-12 * max(squares[-1], 1e-300)
    basis = (unit @ (directions[:, independent] / np.sqrt(squares[independent]))).astype(np.float32)
    energy: FloatArray = np.sum((basis.T @ noise) ** 2, axis=0)
    return energy
