"""Residual analysis: autocorrelation, and cross-correlation with the motion.

G. E. P. Box, G. M. Jenkins, Time Series Analysis (1970); L. Ljung, System Identification, 2nd ed. (1999),
chapter on model validation.
"""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy

from palpate.estimation.signals.blocks import rows_of_runs
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

SIGMAS_99 = NormalDist().inv_cdf(0.995)
_QUANTILE = 0.9  # quantile of absolute residuals that is used; the largest occur at kinks of the motion
_QUANTILE_SIGMAS = 1.6448536269514722  # this quantile of the absolute value of standard Gaussian noise


@dataclass(frozen=True)
class Correlation:
    """Correlation function with its confidence band."""

    lag: IntArray  # lags, shape (m,) [samples]
    value: FloatArray  # correlation from -1 to 1, shape (m,); NaN without any pair of samples at that lag
    band: FloatArray  # half width of the 99 % interval for uncorrelated signals, shape (m,)

    @property
    def outside(self) -> float:
        """Share of the lags outside the band, 0.01 by chance; lag 0 of an autocorrelation is excluded."""
        known = np.isfinite(self.value) & np.isfinite(self.band)
        return float(np.mean(np.abs(self.value[known]) > self.band[known])) if known.any() else float("nan")


def autocorrelation(residual: FloatArray, run: IntArray, max_lag: int) -> Correlation:
    """Compute the autocorrelation of a residual within runs, beginning at lag 0.

    r_k = mean(e_t e_(t+k)) / mean(e_t^2) over the available pairs; for white noise, 99 % of the values lie
    within +-2.58 / sqrt(pairs).

    Args:
        residual: residual, NaN if unknown, shape (n,); its mean is subtracted.
        run: run number of each sample, shape (n,).
        max_lag: largest lag [samples].
    """
    products, pairs = _lag_products(residual, residual, run, max_lag)
    mean = products / np.maximum(pairs, 1)
    value = np.where(pairs > 0, mean, np.nan)[max_lag:] / (mean[max_lag] or np.nan)
    band = SIGMAS_99 / np.sqrt(np.maximum(pairs[max_lag:], 1))
    band[0] = np.nan  # a signal is correlated with itself
    return Correlation(np.arange(max_lag + 1), value, band)


def cross_correlation(residual: FloatArray, motion: FloatArray, run: IntArray, max_lag: int) -> Correlation:
    """Compute the cross-correlation of a residual with the motion `lag` samples earlier.

    r_k = mean(e_(t+k) u_t) / (rms(e) rms(u)). For independent signals, 99 % of the values lie within
    +-2.58 sqrt(P / pairs), where P = sum_k r_e(k) r_u(k) accounts for their autocorrelations (Ljung).

    Args:
        residual: residual e, NaN if unknown, shape (n,); its mean is subtracted.
        motion: motion signal u, NaN if unknown, shape (n,); its mean is subtracted.
        run: run number of each sample, shape (n,).
        max_lag: largest lag [samples].
    """
    u = np.where(np.isfinite(residual), motion, np.nan)
    products, pairs = _lag_products(u, residual, run, max_lag)
    scale = float(np.sqrt(_variance(residual) * _variance(u)))
    value = np.where(pairs > 0, products / np.maximum(pairs, 1), np.nan) / (scale or np.nan)
    acfs = [autocorrelation(signal, run, max_lag).value for signal in (residual, u)]
    acf_product = np.nan_to_num(acfs[0] * acfs[1])
    inflation = max(2.0 * float(acf_product[1:].sum()) + float(acf_product[0]), 1.0)
    band = SIGMAS_99 * np.sqrt(inflation / np.maximum(pairs, 1))
    return Correlation(np.arange(-max_lag, max_lag + 1), value, band)


def _lag_products(a: FloatArray, b: FloatArray, run: IntArray, max_lag: int) -> tuple[FloatArray, FloatArray]:
    """Return sums of a_t b_(t+k) after subtraction of means, and numbers of pairs, for |k| <= max_lag."""
    products, pairs = np.zeros(2 * max_lag + 1), np.zeros(2 * max_lag + 1)
    centered_a, centered_b = _subtract_mean(a), _subtract_mean(b)
    for rows in rows_of_runs(run):
        products += _sum_lagged(centered_a[rows], centered_b[rows], max_lag)
        known_a, known_b = (np.isfinite(signal[rows]).astype(np.float64) for signal in (a, b))
        pairs += _sum_lagged(known_a, known_b, max_lag)
    return products, np.rint(pairs)


def _subtract_mean(values: FloatArray) -> FloatArray:
    """Return values (n,) minus their mean; unknown values become 0."""
    known = np.isfinite(values)
    mean = float(values[known].mean()) if known.any() else 0.0
    return np.where(known, values - mean, 0.0)


def _sum_lagged(a: FloatArray, b: FloatArray, max_lag: int) -> FloatArray:
    """Return the sums of a_t b_(t+k) for k from -max_lag to max_lag."""
    correlations, n = scipy.signal.correlate(b, a, mode="full", method="auto"), len(a)
    reach = min(max_lag, n - 1)
    sums = np.zeros(2 * max_lag + 1)
    sums[max_lag - reach : max_lag + reach + 1] = correlations[n - 1 - reach : n + reach]
    return sums


def _variance(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.var(known)) if len(known) else 0.0


def correlation_coefficient(x: FloatArray, y: FloatArray) -> float:
    """Return Pearson's correlation of two signals; 0 if either is constant or empty.

    Args:
        x: first signal, shape (n,).
        y: second signal, shape (n,).
    """
    if len(x) == 0 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return 0.0
    return float(np.corrcoef(x, y)[0, 1])


def noise_between_samples(residuals: FloatArray, run: IntArray, inliers: BoolArray) -> float:
    """Estimate the noise of residuals, which changes from sample to sample [effort]; NaN without neighbors.

    It is estimated from differences of neighboring inliers, sigma = rms(difference) / sqrt(2) (J. von
    Neumann, Annals of Mathematical Statistics 12, 1941). A model error that changes as fast counts as noise.

    Args:
        residuals: effort minus prediction, in order of time within each run, shape (n,).
        run: run of each sample, shape (n,).
        inliers: mask of the samples to use, shape (n,).
    """
    pairs = (run[1:] == run[:-1]) & inliers[1:] & inliers[:-1]
    return float(np.sqrt(np.mean(np.diff(residuals)[pairs] ** 2) / 2)) if pairs.any() else float("nan")


def residual_scale(residuals: FloatArray) -> float:
    """Estimate the standard deviation of residuals from the 90 % quantile of their absolute values.

    Args:
        residuals: residuals, shape (n,).
    """
    return float(np.quantile(np.abs(residuals), _QUANTILE)) / _QUANTILE_SIGMAS


def fit_percent(measured: FloatArray, modeled: FloatArray) -> float:
    """Compute the fit 100 (1 - |y - ym| / |y - mean(y)|) [%]: 100 is perfect, 0 as good as the mean.

    It is 100 % minus the normalized root mean square error of system identification (L. Ljung, System
    Identification, 2nd ed., 1999; `compare` of its toolbox). It is negative if worse than the
    mean, and NaN for a constant measurement.

    Args:
        measured: measured signal y, NaN is ignored, shape (n,).
        modeled: signal ym of the model, NaN is ignored, shape (n,).
    """
    known = np.isfinite(measured) & np.isfinite(modeled)
    y, ym = measured[known], modeled[known]
    scale = float(np.linalg.norm(y - y.mean())) if len(y) else 0.0
    return 100.0 * (1.0 - float(np.linalg.norm(y - ym)) / scale) if scale > 0.0 else float("nan")
