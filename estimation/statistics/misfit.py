"""How far a model is off, beside what changes from one sample to the next."""

from dataclasses import dataclass

import numpy as np

from robot_io.types import BoolArray, FloatArray, IntArray

_SHARE = 0.9  # of the residuals: a few samples at kinks of the motion say nothing about the model
_SIGMAS = 1.6448536269514722  # below which the magnitude of that share of Gaussian noise lies


@dataclass(frozen=True)
class Misfit:
    """What a model leaves."""

    noise: float  # standard deviation of what changes from sample to sample, in the effort's unit
    times: float  # size of the residuals over that, about 1 where a model leaves nothing but noise


def misfit(residuals: FloatArray, run: IntArray, inliers: BoolArray) -> Misfit:
    """Compare the residuals with their noise.

    Noise changes from sample to sample, and what a model misses mostly does not: the noise is taken from the
    differences of neighbours that a robust method kept, sigma = rms(difference) / sqrt(2) (J. von Neumann,
    Annals of Mathematical Statistics 12, 1941), the size from all samples. A misfit that is itself as quick
    as the samples is not seen.

    Args:
        residuals: effort minus prediction, in order of time within each run, shape (n,).
        run: of each sample, shape (n,).
        inliers: samples that were not set aside, shape (n,).

    Returns:
        NaN where no two neighbours are left; `times` is NaN where nothing changes.
    """
    pairs = inliers[1:] & inliers[:-1] & (run[1:] == run[:-1])
    if not pairs.any():
        return Misfit(float("nan"), float("nan"))
    noise = float(np.sqrt(np.mean(np.diff(residuals)[pairs] ** 2) / 2))
    return Misfit(noise, residual_scale(residuals) / noise if noise > 0 else float("nan"))


def residual_scale(residuals: FloatArray) -> float:
    """Standard deviation of residuals (n,), from the magnitude below which nine tenths of them lie."""
    return float(np.quantile(np.abs(residuals), _SHARE)) / _SIGMAS


def fit_percent(measured: FloatArray, modelled: FloatArray) -> float:
    """100 (1 - |y - ym| / |y - mean(y)|): 100 for a perfect model, 0 for one as good as the mean.

    The normalised root mean square error of system identification (L. Ljung, System Identification, 2nd ed.,
    1999; `compare` of its toolbox).

    Args:
        measured: y, shape (n,); NaN is left out.
        modelled: ym, shape (n,); likewise.

    Returns:
        Below zero for a model that is worse than the mean; NaN where the measurement is constant.
    """
    both = np.isfinite(measured) & np.isfinite(modelled)
    y, ym = measured[both], modelled[both]
    size = float(np.linalg.norm(y - y.mean())) if len(y) else 0.0
    return 100.0 * (1.0 - float(np.linalg.norm(y - ym)) / size) if size > 0.0 else float("nan")
