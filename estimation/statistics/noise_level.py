"""Heteroscedastic noise level: a constant part, and one that grows with the effort."""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy

from robot_io.types import FloatArray

# Standard deviation over median absolute deviation of Gaussian noise.
MAD_TO_SIGMA = 1.0 / NormalDist().inv_cdf(0.75)
_BIN_COUNT = 20
_LEAST_PER_BIN = 25
_NO_NOISE = 1e-100  # in any unit; its inverse square is still finite
_FLOOR_SHARE = 1e-3  # of the overall level; keeps weights finite where no noise is predicted


def robust_sigma(residuals: FloatArray) -> float:
    """Estimate the standard deviation from the median absolute residual, robust to outliers.

    Args:
        residuals: shape (n,).
    """
    return float(MAD_TO_SIGMA * np.median(np.abs(residuals)))


@dataclass(frozen=True)
class NoiseLevel:
    """Noise with sigma^2 = floor^2 + (share * effort)^2."""

    floor: float  # standard deviation at no effort, in the effort's unit
    share: float  # growth with the effort, such as 0.1 for 10 %

    def sigma(self, effort: FloatArray) -> FloatArray:
        """Return the standard deviation at each predicted effort, shape (n,).

        Args:
            effort: predicted, shape (n,).
        """
        return np.hypot(self.floor, self.share * effort)


def fit_noise_level(residuals: FloatArray, predicted: FloatArray) -> NoiseLevel:
    """Fit floor and share to residuals, robust to outliers.

    The robust variance in bins of equal count along |predicted| is fitted by floor^2 + share^2 effort^2.

    Args:
        residuals: shape (n,).
        predicted: predicted effort, shape (n,).
    """
    overall = max(robust_sigma(residuals), _NO_NOISE)
    bins = min(_BIN_COUNT, len(residuals) // _LEAST_PER_BIN)
    if bins < 2 or overall == _NO_NOISE:
        return NoiseLevel(overall, 0.0)
    order = np.argsort(np.abs(predicted))[len(residuals) % bins :].reshape(bins, -1)
    variance = (MAD_TO_SIGMA * np.median(np.abs(residuals[order]), axis=1)) ** 2
    square = np.mean(predicted[order] ** 2, axis=1)
    # The error of a variance grows with the variance.
    trust = 1.0 / np.maximum(variance, (_FLOOR_SHARE * overall) ** 2)
    design = np.column_stack([np.ones(bins), square])
    (floor2, share2), _ = scipy.optimize.nnls(design * trust[:, None], variance * trust)
    return NoiseLevel(max(float(np.sqrt(floor2)), _FLOOR_SHARE * overall), float(np.sqrt(share2)))
