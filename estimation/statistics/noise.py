"""Noise of residuals: level and autocorrelation."""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy

from palpate.estimation.signals.blocks import blocks
from palpate.robot_io.types import FloatArray, IntArray

# Standard deviation over median absolute deviation of Gaussian noise.
MAD_TO_SIGMA = 1.0 / NormalDist().inv_cdf(0.75)
_BIN_COUNT = 20
_MIN_PER_BIN = 25
_MIN_SIGMA = 1e-100  # least noise in any unit, so that its inverse square is finite
_FLOOR_SHARE = 1e-3  # least noise relative to its overall level, which keeps weights finite


def robust_sigma(residuals: FloatArray) -> float:
    """Estimate the standard deviation from the median absolute residual, robustly against outliers.

    Args:
        residuals: residuals, shape (n,).
    """
    return float(MAD_TO_SIGMA * np.median(np.abs(residuals)))


@dataclass(frozen=True)
class NoiseLevel:
    """Noise with sigma^2 = floor^2 + (share * effort)^2."""

    floor: float  # standard deviation at zero effort [effort]
    share: float  # increase relative to the effort, such as 0.1 for 10 %

    def sigma(self, effort: FloatArray) -> FloatArray:
        """Return the standard deviation at each predicted effort, shape (n,).

        Args:
            effort: predicted effort, shape (n,).
        """
        return np.hypot(self.floor, self.share * effort)


def fit_noise_level(residuals: FloatArray, predicted: FloatArray) -> NoiseLevel:
    """Fit floor and share of the noise to residuals, robustly against outliers.

    Samples are sorted by |predicted| into bins of equal count. The function floor^2 + share^2 effort^2 is
    fitted to the robust variances of the bins.

    Args:
        residuals: residuals, shape (n,).
        predicted: predicted effort, shape (n,).
    """
    overall = max(robust_sigma(residuals), _MIN_SIGMA)
    bin_count = min(_BIN_COUNT, len(residuals) // _MIN_PER_BIN)
    if bin_count < 2 or overall == _MIN_SIGMA:
        return NoiseLevel(overall, 0.0)
    order = np.argsort(np.abs(predicted))[len(residuals) % bin_count :].reshape(bin_count, -1)
    variance = (MAD_TO_SIGMA * np.median(np.abs(residuals[order]), axis=1)) ** 2
    mean_square = np.mean(predicted[order] ** 2, axis=1)
    # The standard error of a variance is proportional to the variance.
    weights = 1.0 / np.maximum(variance, (_FLOOR_SHARE * overall) ** 2)
    design = np.column_stack([np.ones(bin_count), mean_square])
    (floor2, share2), _ = scipy.optimize.nnls(design * weights[:, None], variance * weights)
    return NoiseLevel(max(float(np.sqrt(floor2)), _FLOOR_SHARE * overall), float(np.sqrt(share2)))


_MAX_AR1 = 0.99  # largest AR(1) coefficient for prewhitening, which divides by 1 minus the coefficient


@dataclass(frozen=True)
class SumCovariance:
    """Covariance of a sum of correlated terms."""

    matrix: FloatArray  # shape (p, p)
    effective_count: float  # number of uncorrelated terms with the same uncertainty, at most n


def sum_covariance(terms: FloatArray, run: IntArray | None = None) -> SumCovariance:
    """Estimate the covariance of the sum over the rows of `terms`, whose expectation is zero.

    Args:
        terms: terms in order of time within each run, shape (n, p).
        run: run number of each row, shape (n,); terms of different runs are uncorrelated. None for one run.
    """
    runs = [terms]
    if run is not None:
        order = np.argsort(run, kind="stable")
        runs = [terms[order[rows]] for rows in blocks(run[order])]
    ar1 = _ar1(runs)
    # Remove the AR(1) part; the first term of a run is scaled to the variance of the others.
    firsts = [part[:1] * np.sqrt(1 - ar1**2) for part in runs]
    rests = [part[1:] - ar1 * part[:-1] for part in runs]
    whitened = [np.concatenate(both) for both in zip(firsts, rests, strict=True)]
    # Choose the number of lags that balances bias and variance (Andrews 1991, eq. 6.2 and 6.4).
    rest_ar1 = _ar1(whitened)
    alpha = float((4 * rest_ar1**2 / ((1 - rest_ar1) ** 2 * (1 + rest_ar1) ** 2)).max(initial=0.0))
    lags = np.ceil(1.1447 * (alpha * len(terms)) ** (1 / 3))
    lag_count = int(np.clip(lags, 1, max(1, max(map(len, runs)) // 2)))
    matrix = sum(_bartlett_covariance(part, lag_count) for part in whitened) / np.outer(1 - ar1, 1 - ar1)
    uncorrelated = np.einsum("ij,ij->j", terms, terms)
    inflation = np.divide(np.diag(matrix), uncorrelated, out=np.ones(len(ar1)), where=uncorrelated > 0)
    return SumCovariance(matrix, len(terms) / max(1.0, float(inflation.max(initial=1.0))))


def _ar1(runs: list[FloatArray]) -> FloatArray:
    """Return the lag-1 autocorrelation of each column, pooled over the runs, shape (p,)."""
    product = sum(np.einsum("ij,ij->j", part[1:], part[:-1]) for part in runs)
    power = sum(np.einsum("ij,ij->j", part, part) for part in runs)
    ar1 = np.divide(product, power, out=np.zeros_like(power), where=power > 0)
    return np.asarray(np.clip(ar1, -_MAX_AR1, _MAX_AR1))


def _bartlett_covariance(terms: FloatArray, lag_count: int) -> FloatArray:
    """Compute Bartlett's estimate as the mean square of moving sums, which avoids a loop over lags."""
    padding = np.zeros((lag_count, terms.shape[1]))
    sums = np.cumsum(np.concatenate([padding, terms, padding[1:]]), axis=0)
    moving_sums = sums[lag_count:] - sums[:-lag_count]
    moving_sums = np.concatenate([sums[lag_count - 1 : lag_count], moving_sums])
    matrix: FloatArray = moving_sums.T @ moving_sums / lag_count
    return matrix
