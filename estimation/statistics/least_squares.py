"""Linear least squares, fast for many samples and few gains, and indifferent to the columns' units."""

from dataclasses import dataclass

import numpy as np

from robot_io.types import FloatArray

# Above this the normal equations lose half of the digits, and the orthogonal solution is worth its time.
_SAFE_CONDITION = 1e6


@dataclass(frozen=True)
class LinearSolution:
    """Gains that minimise the sum of squared weighted residuals."""

    # Shape (p,); the smallest ones (in scaled columns) where the columns do not determine them.
    gains: FloatArray
    condition_number: float  # of the weighted columns, each scaled to unit length


def solve(columns: FloatArray, effort: FloatArray, weights: FloatArray | None = None) -> LinearSolution:
    """Minimise |weights * (effort - columns @ gains)|.

    Args:
        columns: shape (n, p).
        effort: shape (n,).
        weights: shape (n,), factor of each residual (1 / sigma); None for equal.
    """
    if weights is not None:
        columns, effort = columns * weights[:, None], effort * weights
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    lengths[lengths == 0.0] = 1.0
    scaled = columns / lengths
    gram = scaled.T @ scaled
    condition = condition_of_gram(gram)
    if condition < _SAFE_CONDITION:
        gains = np.linalg.solve(gram, scaled.T @ effort)
    else:
        gains = np.linalg.lstsq(scaled, effort, rcond=None)[0]
    return LinearSolution(gains / lengths, condition)


def condition_of_gram(gram: FloatArray) -> float:
    """Condition number of a matrix X from X'X; infinite when X has no full rank."""
    if not len(gram):
        return 1.0
    eigenvalues = np.linalg.eigvalsh(gram)
    if eigenvalues[0] <= eigenvalues[-1] * np.finfo(float).eps * len(gram):
        return float("inf")
    return float(np.sqrt(eigenvalues[-1] / eigenvalues[0]))
