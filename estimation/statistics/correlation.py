"""Residual analysis: whether what a model leaves is white, and whether it has to do with the motion.

G. E. P. Box, G. M. Jenkins, Time Series Analysis (1970); L. Ljung, System Identification, 2nd ed. (1999),
chapter on model validation.
"""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy

from estimation.signals.blocks import rows_of_runs
from robot_io.types import FloatArray, IntArray

SIGMAS_99 = NormalDist().inv_cdf(0.995)


@dataclass(frozen=True)
class Correlation:
    """A correlation over lags."""

    lag: IntArray  # in samples, shape (m,)
    value: FloatArray  # correlation, -1 to 1, shape (m,); NaN where no two samples are that far apart
    band: FloatArray  # half of the interval that holds 99 % of what uncorrelated signals give, shape (m,)

    @property
    def outside(self) -> float:
        """Share of the lags, but lag 0 of an autocorrelation, that are outside the band; 0.01 is chance."""
        told = np.isfinite(self.value) & np.isfinite(self.band)
        return float(np.mean(np.abs(self.value[told]) > self.band[told])) if told.any() else float("nan")


def autocorrelation(residual: FloatArray, run: IntArray, most: int) -> Correlation:
    """Correlation of a residual with itself later on, from lag 0 on; never from one run to the next.

    r_k = mean(e_t e_(t+k)) / mean(e_t^2) over the pairs that are there; of white noise, 99 % are within
    +-2.58 / sqrt(pairs).

    Args:
        residual: shape (n,); NaN where there is none. Its mean is taken off.
        run: of each sample, shape (n,).
        most: largest lag in samples.
    """
    products, pairs = _products(residual, residual, run, most)
    mean = products / np.maximum(pairs, 1)
    value = np.where(pairs > 0, mean, np.nan)[most:] / (mean[most] or np.nan)
    band = SIGMAS_99 / np.sqrt(np.maximum(pairs[most:], 1))
    band[0] = np.nan  # a signal is correlated with itself
    return Correlation(np.arange(most + 1), value, band)


def cross_correlation(residual: FloatArray, motion: FloatArray, run: IntArray, most: int) -> Correlation:
    """Correlation of a residual with the motion `lag` samples before; at negative lags with that after.

    r_k = mean(e_(t+k) u_t) / (rms(e) rms(u)). If they are independent, 99 % are within
    +-2.58 sqrt(P / pairs), where P = sum_k r_e(k) r_u(k) counts for their own colours (Ljung).

    Args:
        residual: e, shape (n,); NaN where there is none. Its mean is taken off.
        motion: u, shape (n,); likewise.
        run: of each sample, shape (n,).
        most: largest lag in samples.
    """
    u = np.where(np.isfinite(residual), motion, np.nan)
    products, pairs = _products(u, residual, run, most)
    size = float(np.sqrt(_power(residual) * _power(u)))
    value = np.where(pairs > 0, products / np.maximum(pairs, 1), np.nan) / (size or np.nan)
    own = [autocorrelation(each, run, most).value for each in (residual, u)]
    colours = np.nan_to_num(own[0] * own[1])
    together = max(2.0 * float(colours[1:].sum()) + float(colours[0]), 1.0)
    return Correlation(
        np.arange(-most, most + 1), value, SIGMAS_99 * np.sqrt(together / np.maximum(pairs, 1))
    )


def _products(a: FloatArray, b: FloatArray, run: IntArray, most: int) -> tuple[FloatArray, FloatArray]:
    """Sum of a_t b_(t+k) without means, and number of such pairs; k from -most to most, (2 most + 1,)."""
    total, pairs = np.zeros(2 * most + 1), np.zeros(2 * most + 1)
    first, second = _centred(a), _centred(b)
    for rows in rows_of_runs(run):
        total += _lagged(first[rows], second[rows], most)
        known, known_too = (np.isfinite(each[rows]).astype(np.float64) for each in (a, b))
        pairs += _lagged(known, known_too, most)
    return total, np.rint(pairs)


def _centred(values: FloatArray) -> FloatArray:
    """Values (n,) without their mean, 0 where there is none."""
    known = np.isfinite(values)
    mean = float(values[known].mean()) if known.any() else 0.0
    return np.where(known, values - mean, 0.0)


def _lagged(a: FloatArray, b: FloatArray, most: int) -> FloatArray:
    """Sum of a_t b_(t+k) for k from -most to most."""
    whole, n = scipy.signal.correlate(b, a, mode="full", method="auto"), len(a)
    reach = min(most, n - 1)
    found = np.zeros(2 * most + 1)
    found[most - reach : most + reach + 1] = whole[n - 1 - reach : n + reach]
    return found


def _power(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.var(known)) if len(known) else 0.0


def likeness(one: FloatArray, other: FloatArray) -> float:
    """Correlation of two signals (n,), 0 where one of them is constant."""
    if len(one) == 0 or np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])
