"""Random effects and corrected tests."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, stdtrit
from scipy.stats import chi2

from palpate.robot_io.types import FloatArray

_NODES = 1_000  # spreads with which a further value is predicted


@dataclass(frozen=True)
class RandomEffects:
    """A parameter that is distributed over measurements: each has its own true value around a common mean."""

    count: int  # measurements
    mean: float  # common mean
    std_err: float  # standard error of the mean
    freedom: float  # degrees of freedom of the intervals: effective number of values less one, at least one
    interval: tuple[float, float]  # 95 %, of the mean
    spread: float  # standard deviation of the true values between measurements
    prediction: tuple[float, float]  # 95 %, of the true value of a further measurement; NaN below three
    inconsistency: float  # I^2: share of the variance of the values that is not due to their standard errors


def random_effects(values: FloatArray, std_errs: FloatArray) -> RandomEffects:
    """Fit mean and spread by Paule and Mandel's estimator, with t intervals.

    Paule and Mandel, J. Res. NBS 87 (1982) 377; see Veroniki et al., Res. Synth. Methods 7 (2016) 55.
    The interval of the mean is that of Hartung and Knapp (2001), whose factor is one at this solution. A few
    precise values may have almost all the weight; its quantile therefore uses the effective number of values
    (Kish, Survey Sampling, 1965). The prediction interval averages over all spreads that the values allow.

    Args:
        values: shape (n,), n at least 1.
        std_errs: standard errors of the values, shape (n,), not negative.
    """
    count = len(values)
    least = 1e-9 * (float(np.abs(values).max()) or 1.0)
    variances = np.maximum(std_errs, least) ** 2

    def weighted_mean(spread_squared: float) -> tuple[float, FloatArray]:
        weights = 1.0 / (variances + spread_squared)
        return float(weights @ values / weights.sum()), weights

    def excess(spread_squared: float) -> float:
        mean, weights = weighted_mean(spread_squared)
        return float(weights @ (values - mean) ** 2) - (count - 1)

    most = float(np.sum((values - values.mean()) ** 2)) + 1e-300  # where the excess is not above zero
    squared = brentq(excess, 0.0, most, xtol=1e-12 * most) if count > 1 and excess(0.0) > 0.0 else 0.0
    mean, weights = weighted_mean(squared)
    std_err = float(weights.sum() ** -0.5)
    freedom = max(float(weights.sum() ** 2 / (weights @ weights)) - 1.0, 1.0)
    half = float(stdtrit(freedom, 0.975)) * std_err if count > 1 else float("nan")
    fixed = 1.0 / variances
    # Typical variance within a measurement (Higgins and Thompson, Stat. Med. 21 (2002) 1539).
    spare = fixed.sum() ** 2 - (fixed**2).sum()
    typical = (count - 1) * fixed.sum() / spare if spare > 0.0 else float(variances.mean())
    share = squared / (squared + typical) if squared > 0.0 else 0.0
    prediction = _prediction_interval(values, variances) if count > 2 else (float("nan"), float("nan"))
    interval = mean - half, mean + half
    return RandomEffects(count, mean, std_err, freedom, interval, squared**0.5, prediction, float(share))


def _prediction_interval(values: FloatArray, variances: FloatArray) -> tuple[float, float]:
    """Return the 95 % interval of the true value of a further measurement, from n > 1 values.

    The weighted sum of squares around the mean has a chi-squared distribution at the true spread, which gives
    the confidence distribution of the spread (W. Viechtbauer, Stat. Med. 26 (2007) 37). The further value is
    predicted with each spread of this distribution (K. Nagashima et al., Stat. Methods Med. Res. 28 (2019)
    1689), since the best spread of few values is often zero. Without standard errors this is Student's t
    interval.
    """
    around = float(np.sum((values - values.mean()) ** 2)) + np.finfo(float).tiny
    spreads = around * np.array([0.0, *np.geomspace(1e-9, 1e9, 400)])  # squared
    weights = 1.0 / (variances + spreads[:, None])
    mean_variances = 1.0 / weights.sum(axis=1)
    means = weights @ values * mean_variances
    sums = np.sum(weights * (values - means[:, None]) ** 2, axis=1) + np.finfo(float).tiny
    drawn = _chi_squared_nodes(len(values) - 1)
    # mean and variance of the further value at the spreads at which the sum of squares is as drawn
    mean, variance = (
        np.interp(-np.log(drawn), -np.log(sums), each) for each in (means, spreads + mean_variances)
    )
    scale = np.sqrt(variance)

    def beyond(value: float, share: float) -> float:
        return float(ndtr((value - mean) / scale).mean()) - share

    ends = float(np.min(mean - 9.0 * scale)), float(np.max(mean + 9.0 * scale))
    exact = 1e-12 * (ends[1] - ends[0])
    low, high = (brentq(beyond, *ends, args=(share,), xtol=exact) for share in (0.025, 0.975))
    return low, high


@lru_cache
def _chi_squared_nodes(freedom: int) -> FloatArray:
    return np.asarray(chi2.ppf((np.arange(_NODES) + 0.5) / _NODES, freedom))


def neighbor_spread_squared(values: FloatArray, std_errs: FloatArray) -> float:
    """Estimate the variance between measurements in excess of their standard errors, from n values.

    With this variance, squared differences between neighbors have on average the expected size (R. C. Paule,
    J. Mandel, J. Res. Natl. Bur. Stand. 87 (1982) 377). One uncertain value therefore hardly counts.

    Args:
        values: series in the order of time, shape (n,).
        std_errs: standard errors of the values, shape (n,).
    """
    squares, noise = np.diff(values) ** 2, std_errs[1:] ** 2 + std_errs[:-1] ** 2
    least, most = 1e-200 + 1e-12 * float(np.mean(values**2)), 0.5 * float(np.mean(squares))

    def excess(log_variance: float) -> float:
        return float(np.mean(squares / (2.0 * np.exp(log_variance) + noise))) - 1.0

    if most <= least or excess(np.log(least)) <= 0.0:
        return least
    if excess(np.log(most)) >= 0.0:  # by rounding, without standard errors
        return most
    return float(np.exp(brentq(excess, np.log(least), np.log(most))))


def shrunk(values: FloatArray, std_errs: FloatArray, effects: RandomEffects) -> FloatArray:
    """Shrink each value towards the mean, the more so the more its standard error exceeds the spread.

    Args:
        values: shape (n,).
        std_errs: standard errors of the values, shape (n,).
        effects: the random-effects model of their group.

    Returns:
        Shape (n,).
    """
    own = effects.spread**2 / np.maximum(effects.spread**2 + std_errs**2, np.finfo(float).tiny)
    return np.asarray(effects.mean + own * (values - effects.mean))


def holm(p_values: Sequence[float]) -> list[float]:
    """Correct the p values of several tests (Holm, Scand. J. Stat. 6 (1979) 65).

    Args:
        p_values: p-values of the single tests.
    """
    order, corrected = np.argsort(p_values), np.empty(len(p_values))
    scaled = np.arange(len(order), 0, -1) * np.array(p_values)[order]
    corrected[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return corrected.tolist()
