"""How large a gain chance alone would give: the best of all candidates on noise of the measured kind.

Surrogates keep the residuals' own distribution and colour, and lose their tie to the motion: each run's
residuals are shifted in time and change sign at random (J. Theiler et al., Physica D 58 (1992)). The largest
gain over all candidates and all their inner parameters is what the observed one must beat (P. H. Westfall,
S. S. Young, Resampling-Based Multiple Testing (1993)).
"""

from collections.abc import Iterable

import numpy as np

from robot_io.types import FloatArray, IntArray

COUNT = 199


def surrogates(
    residual: FloatArray, run: IntArray, rng: np.random.Generator, count: int = COUNT
) -> FloatArray:
    """Residuals (w,) of noise like the ones given, shape (w, count)."""
    made = np.empty((len(residual), count))
    for number in np.unique(run):
        rows = np.flatnonzero(run == number)
        shifts = (np.arange(len(rows))[:, None] + rng.integers(0, len(rows), count)) % len(rows)
        made[rows] = residual[rows][shifts] * rng.choice([-1.0, 1.0], count)
    return made


def best_gains(noise: FloatArray, base: FloatArray, candidates: Iterable[FloatArray]) -> FloatArray:
    """Largest share of the error that any candidate takes away from each surrogate.

    Args:
        noise: surrogates (w, s).
        base: whitened columns (w, q) of the model without a candidate.
        candidates: whitened columns of the model with one, each of shape (w, q').
    """
    noise = noise.astype(np.float32)
    explained = _explained(noise, base)
    left = np.sum(noise**2, axis=0) - explained
    best = np.zeros(noise.shape[1])
    for columns in candidates:
        best = np.maximum(best, (_explained(noise, columns) - explained) / left)
    return best


def p_value(gain: float, chance: FloatArray) -> float:
    """How often chance alone does as well; never zero, since only so many surrogates were made."""
    return float((1 + np.sum(chance >= gain)) / (1 + len(chance)))


def _explained(noise: FloatArray, columns: FloatArray) -> FloatArray:
    """Energy of each surrogate (w, s) within the span of columns (w, q), shape (s,)."""
    if columns.shape[1] == 0:
        return np.zeros(noise.shape[1])
    width = np.sqrt(np.sum(columns**2, axis=0))
    u, size, _ = np.linalg.svd(columns / np.where(width > 0.0, width, 1.0), full_matrices=False)
    basis = u[:, size > 1e-6 * max(size[0], 1e-300)].astype(np.float32)
    energy: FloatArray = np.sum((basis.T @ noise) ** 2, axis=0)
    return energy
