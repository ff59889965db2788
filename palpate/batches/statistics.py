"""Random effects and corrected tests."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import t as student_t

from palpate.robot_io.types import FloatArray


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
    The intervals are those of Hartung and Knapp (2001), whose factor is one at this solution, and of Higgins
    et al., J. R. Stat. Soc. A 172 (2009) 137. A few precise values may have almost all the weight; the
    quantiles therefore use the effective number of values (Kish, Survey Sampling, 1965). The prediction
    interval is still somewhat too short from few values (Partlett and Riley, Stat. Med. 36 (2017) 301).

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
    half = float(student_t.ppf(0.975, freedom)) * std_err if count > 1 else float("nan")
    wide = float("nan")
    if count > 2:
        wide = float(student_t.ppf(0.975, max(freedom - 1.0, 1.0)) * np.hypot(np.sqrt(squared), std_err))
    fixed = 1.0 / variances
    # Typical variance within a measurement (Higgins and Thompson, Stat. Med. 21 (2002) 1539).
    spare = fixed.sum() ** 2 - (fixed**2).sum()
    typical = (count - 1) * fixed.sum() / spare if spare > 0.0 else float(variances.mean())
    share = squared / (squared + typical) if squared > 0.0 else 0.0
    interval, prediction = (mean - half, mean + half), (mean - wide, mean + wide)
    return RandomEffects(count, mean, std_err, freedom, interval, squared**0.5, prediction, float(share))


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
