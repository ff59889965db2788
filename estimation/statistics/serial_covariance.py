"""Heteroscedasticity and autocorrelation consistent (HAC) covariance of a sum of correlated terms.

Bartlett's kernel with Andrews' bandwidth after prewhitening, run by run. W. K. Newey, K. D. West, A Simple,
Positive Semi-Definite, Heteroskedasticity and Autocorrelation Consistent Covariance Matrix, Econometrica 55
(1987); D. W. K. Andrews, J. C. Monahan, An Improved HAC Covariance Matrix Estimator, Econometrica 60 (1992).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from estimation.signals.blocks import blocks
from robot_io.types import FloatArray, IntArray

_MAX_AR1 = 0.99  # prewhitening closer to 1 would divide by almost zero


@dataclass(frozen=True)
class SumCovariance:
    """Covariance of a sum of correlated terms."""

    matrix: FloatArray  # shape (p, p)
    effective_count: float  # number of uncorrelated terms that would be as uncertain; at most n


def sum_covariance(terms: FloatArray, run: IntArray | None = None) -> SumCovariance:
    """Estimate the covariance of the sum over the rows of `terms`, whose expectation is zero.

    Args:
        terms: shape (n, p), in order of time within each run.
        run: shape (n,), number of each row's run; terms of different runs are uncorrelated. None for one run.
    """
    pieces = [terms[rows] for rows in _runs(run, len(terms))]
    ar1 = _ar1(pieces)
    whitened = [_whiten(piece, ar1) for piece in pieces]
    lag_count = _bandwidth(_ar1(whitened), len(terms), max(map(len, pieces)))
    matrix = sum(_bartlett(piece, lag_count) for piece in whitened) / np.outer(1 - ar1, 1 - ar1)
    independent = np.einsum("ij,ij->j", terms, terms)
    inflation = np.divide(np.diag(matrix), independent, out=np.ones(len(ar1)), where=independent > 0)
    return SumCovariance(matrix, len(terms) / max(1.0, float(inflation.max(initial=1.0))))


def _runs(run: IntArray | None, count: int) -> Iterator[IntArray]:
    if run is None:
        yield np.arange(count)
        return
    order = np.argsort(run, kind="stable")
    yield from (order[rows] for rows in blocks(run[order]))


def _ar1(pieces: list[FloatArray]) -> FloatArray:
    """First autocorrelation of each column, pooled over the runs, shape (p,)."""
    product = sum(np.einsum("ij,ij->j", piece[1:], piece[:-1]) for piece in pieces)
    power = sum(np.einsum("ij,ij->j", piece, piece) for piece in pieces)
    ar1 = np.divide(product, power, out=np.zeros_like(power), where=power > 0)
    return np.asarray(np.clip(ar1, -_MAX_AR1, _MAX_AR1))


def _whiten(piece: FloatArray, ar1: FloatArray) -> FloatArray:
    """Remove the AR(1) part; the first term is scaled to the variance of the others."""
    first = piece[:1] * np.sqrt(1 - ar1**2)
    return np.concatenate([first, piece[1:] - ar1 * piece[:-1]])


def _bandwidth(ar1: FloatArray, count: int, longest: int) -> int:
    """Number of lags that balances bias and variance (Andrews 1991, eq. 6.2 and 6.4)."""
    alpha = 4 * ar1**2 / ((1 - ar1) ** 2 * (1 + ar1) ** 2)
    lags = 1.1447 * (float(alpha.max(initial=0.0)) * count) ** (1 / 3)
    return int(np.clip(np.ceil(lags), 1, max(1, longest // 2)))


def _bartlett(piece: FloatArray, lag_count: int) -> FloatArray:
    """Bartlett's estimate as the mean square of moving sums, which avoids a loop over lags."""
    edge = np.zeros((lag_count, piece.shape[1]))
    sums = np.cumsum(np.concatenate([edge, piece, edge[1:]]), axis=0)
    moving = sums[lag_count:] - sums[:-lag_count]
    moving = np.concatenate([sums[lag_count - 1 : lag_count], moving])
    matrix: FloatArray = moving.T @ moving / lag_count
    return matrix
