"""Misfit of a model: its residual relative to the noise between neighbouring samples."""

from dataclasses import dataclass

import numpy as np

from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_SHARE = 0.9  # of the residuals; the largest, at kinks of the motion, say nothing about the model
_SIGMAS = 1.6448536269514722  # that quantile of the magnitude of Gaussian noise


@dataclass(frozen=True)
class Misfit:
    """Size of a model's residual."""

    noise: float  # standard deviation of the part that changes from sample to sample, in the effort's unit
    times: float  # size of the residual over that; about 1 for a complete model


def misfit(residuals: FloatArray, run: IntArray, inliers: BoolArray) -> Misfit:
    """Compare the residuals with their noise.

    Noise changes from sample to sample; the error of a model mostly does not. The noise is estimated from the
    differences of neighbouring inliers, sigma = rms(difference) / sqrt(2) (J. von Neumann, Annals of
    Mathematical Statistics 12, 1941), the size from all samples. A misfit that changes as fast as the samples
    is not seen.

    Args:
        residuals: effort minus prediction, in order of time within each run, shape (n,).
        run: of each sample, shape (n,).
        inliers: samples that a robust method kept, shape (n,).

    Returns:
        NaN without two neighbouring inliers; `times` is NaN for zero noise.
    """
    pairs = inliers[1:] & inliers[:-1] & (run[1:] == run[:-1])
    if not pairs.any():
        return Misfit(float("nan"), float("nan"))
    noise = float(np.sqrt(np.mean(np.diff(residuals)[pairs] ** 2) / 2))
    return Misfit(noise, residual_scale(residuals) / noise if noise > 0 else float("nan"))


def residual_scale(residuals: FloatArray) -> float:
    """Estimate the standard deviation of residuals from the magnitude that nine tenths do not exceed.

    Args:
        residuals: shape (n,).
    """
    return float(np.quantile(np.abs(residuals), _SHARE)) / _SIGMAS


def fit_percent(measured: FloatArray, modelled: FloatArray) -> float:
    """Compute the fit 100 (1 - |y - ym| / |y - mean(y)|) [%]: 100 is perfect, 0 as good as the mean.

    The normalised root mean square error of system identification (L. Ljung, System Identification, 2nd ed.,
    1999; `compare` of its toolbox).

    Args:
        measured: y, shape (n,); NaN is ignored.
        modelled: ym, shape (n,); likewise.

    Returns:
        Negative for a model that is worse than the mean; NaN for a constant measurement.
    """
    both = np.isfinite(measured) & np.isfinite(modelled)
    y, ym = measured[both], modelled[both]
    size = float(np.linalg.norm(y - y.mean())) if len(y) else 0.0
    return 100.0 * (1.0 - float(np.linalg.norm(y - ym)) / size) if size > 0.0 else float("nan")
