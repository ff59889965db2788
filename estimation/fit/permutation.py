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
_DEPENDENT = 1e-12  # squared share of a column outside the span of others below which it is in it


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
    """Compute for surrogates of the noise the largest share (COUNT,) of the error that a candidate explains.

    The loop over candidates ends early when more than `most` surrogates reach the observed improvement.

    Args:
        noise: residuals of the best model, in order of time within each run, shape (w,).
        run: run number of each residual, shape (w,).
        base: columns of the model without a candidate, shape (w, q).
        candidates: columns of the model with each candidate, shape (w, q') each.
        rng: random generator for the surrogates.
        observed: improvement by the best candidate on the data.
        most: largest number of surrogates that may reach it.
    """
    surrogates = _surrogate_residuals(noise, run, rng).astype(np.float32, order="C")
    basis = _orthonormal(base)
    explained, count = _explained(surrogates, basis), base.shape[1]
    residual = np.sum(surrogates**2, axis=0) - explained
    best = np.zeros(surrogates.shape[1])
    for columns in candidates:
        if np.array_equal(columns[:, :count], base):  # only what the candidate adds (Frisch and Waugh)
            added = columns[:, count:]
            left = added - basis @ (basis.T @ added)
            is_new = np.sum(left**2, axis=0) > _DEPENDENT * np.sum(added**2, axis=0)
            gain = _explained(surrogates, _orthonormal(left[:, is_new]))
        else:
            gain = _explained(surrogates, _orthonormal(columns)) - explained
        best = np.maximum(best, gain / residual)
        if np.sum(best >= observed) > most:
            break
    return best


def _surrogate_residuals(noise: FloatArray, run: IntArray, rng: np.random.Generator) -> FloatArray:
    """Generate surrogates of the noise by random shifts in time and random signs, (w, COUNT)."""
    surrogates = np.empty((COUNT, len(noise)))
    for number in np.unique(run):
        rows = np.flatnonzero(run == number)
        shifts, signs = rng.integers(0, len(rows), COUNT), rng.choice([-1.0, 1.0], COUNT)
        shifted = np.lib.stride_tricks.sliding_window_view(np.tile(noise[rows], 2), len(rows))
        surrogates[:, rows] = shifted[shifts] * signs[:, None]
    return surrogates.T


def _orthonormal(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the span of columns (w, q)."""
    if columns.shape[1] == 0:
        return columns
    lengths = np.sqrt(np.sum(columns**2, axis=0))
    unit = columns / np.where(lengths > 0.0, lengths, 1.0)
    squares, directions = np.linalg.eigh(unit.T @ unit)  # far faster than a singular value decomposition
    independent = squares > _DEPENDENT * max(squares[-1], 1e-300)
    return np.asarray(unit @ (directions[:, independent] / np.sqrt(squares[independent])))


def _explained(noise: NDArray[np.float32], basis: FloatArray) -> FloatArray:
    """Return the sum of squares of each surrogate (w, s) within the span of a basis (w, q), shape (s,)."""
    energy: FloatArray = np.sum((basis.T.astype(np.float32) @ noise) ** 2, axis=0)
    return energy
