"""What a residual costs: its square, or less where it lies far off."""

from enum import StrEnum

import numpy as np

from estimation.statistics.noise_level import robust_sigma
from robot_io.types import FloatArray

CAUCHY_CUT = 2.385  # in sigmas: 95 % efficient at Gaussian noise
_SMALLEST_RESIDUAL = 0.05  # in sigmas: keeps 1 / |residual| finite


class Loss(StrEnum):
    """Loss of a standardised residual u."""

    LINEAR = "linear"  # u^2 / 2: least squares
    CAUCHY = "cauchy"  # grows with log u: stands outliers
    BIWEIGHT = "biweight"  # Cauchy's, and from there a few steps with what is far off left out: see `m_steps`

    def weight(self, standardised: FloatArray) -> FloatArray:
        """psi(u) / u, shape (n,): the weight in an equivalent least squares."""
        if self is Loss.LINEAR:
            return np.ones_like(standardised)
        weight: FloatArray = 1.0 / (1.0 + (standardised / CAUCHY_CUT) ** 2)
        return weight

    def slope(self, standardised: FloatArray) -> FloatArray:
        """Derivative of psi, shape (n,)."""
        if self is Loss.LINEAR:
            return np.ones_like(standardised)
        square = (standardised / CAUCHY_CUT) ** 2
        slope: FloatArray = (1.0 - square) / (1.0 + square) ** 2
        return slope


def absolute_share(residuals: FloatArray) -> FloatArray:
    """Squared weights with which least squares, repeated, minimises absolute residuals, shape (n,)."""
    smallest = _SMALLEST_RESIDUAL * max(robust_sigma(residuals), np.finfo(float).tiny)
    return np.asarray(1.0 / np.maximum(np.abs(residuals), smallest))
