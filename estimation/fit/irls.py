"""Robust fits: loss functions, and iteratively reweighted least squares for linear and nonlinear models.

After each step or two, the biweight's psi and the noise of each sample are estimated again from the samples
inside. From a nearby start, this number of steps is as efficient as the fully iterated estimate (D. G.
Simpson, D. Ruppert, R. J. Carroll, On One-Step GM Estimates and Stability of Inferences in Linear Regression,
JASA 87 (1992)).
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palpate.estimation.statistics.least_squares import solve
from palpate.estimation.statistics.noise import NoiseLevel, fit_noise_level, robust_sigma
from palpate.robot_io.types import BoolArray, FloatArray

CUT = 5.5  # cut of the biweight in sigmas: 97.5 % efficient at Gaussian noise
_CAUCHY_CUT = 2.385  # in sigmas: 95 % efficient at Gaussian noise
_SMALLEST_RESIDUAL = 0.05  # in sigmas: keeps 1 / |residual| finite
_NO_NOISE = 1e-100  # in any unit; the inverse of its square is still a number
_INSIDE = 4.0  # sigmas; larger residuals are not used to estimate the noise
_LEVELS = 3  # estimates of the noise level
_STEPS = 2  # reweighted fits for each noise level
_SETTLED = 1e-4  # change in standard errors that ends the iteration
_FEWEST_SHARE = 0.05  # share of samples needed to estimate the noise

Evaluate = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From parameters (p,) to the predicted effort (n,) and its slopes by them (n, p)."""


class Loss(StrEnum):
    """Loss of a standardized residual u."""

    LINEAR = "linear"  # u^2 / 2: least squares
    CAUCHY = "cauchy"  # grows with log u: stands outliers
    BIWEIGHT = "biweight"  # Cauchy's, and from there a few steps with what is far off left out: see `irls`


def cauchy_influence(standardised: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Cauchy's weight psi(u) / u and the slope of psi, each of shape (n,).

    Args:
        standardised: residuals u divided by their scale, shape (n,).
    """
    square = (standardised / _CAUCHY_CUT) ** 2
    return 1.0 / (1.0 + square), (1.0 - square) / (1.0 + square) ** 2


def absolute_share(residuals: FloatArray) -> FloatArray:
    """Return squared weights of the least-squares step that minimizes absolute residuals, shape (n,).

    Args:
        residuals: shape (n,).
    """
    smallest = max(_SMALLEST_RESIDUAL * robust_sigma(residuals), _NO_NOISE)
    return np.asarray(1.0 / np.maximum(np.abs(residuals), smallest))


@dataclass(frozen=True)
class IrlsResult:
    """Result of iteratively reweighted least squares."""

    values: FloatArray  # parameters, shape (p,)
    slopes: FloatArray  # of the prediction by them, shape (n, p)
    residuals: FloatArray  # effort minus prediction, shape (n,)
    sigma: FloatArray  # noise of each sample, shape (n,)
    level: NoiseLevel  # the same as floor and share

    @property
    def inside(self) -> BoolArray:
        """Samples with any weight, shape (n,)."""
        return np.abs(self.residuals) < CUT * self.sigma

    @property
    def influence(self) -> tuple[FloatArray, FloatArray]:
        """Psi of the standardized residuals and its slope, each of shape (n,)."""
        standardised = self.residuals / self.sigma
        square = np.minimum((standardised / CUT) ** 2, 1.0)
        return standardised * (1 - square) ** 2, (1 - square) * (1 - 5 * square)


def irls(
    evaluate: Evaluate, effort: FloatArray, start: FloatArray, known: NoiseLevel | None = None
) -> IrlsResult:
    """Compute an M-estimate by iteratively reweighted least squares.

    Args:
        evaluate: the model.
        effort: measured effort, shape (n,).
        start: starting parameters, which must fit most samples, shape (p,).
        known: noise level if it is known; None to estimate it from the residuals.
    """
    values = start
    predicted, slopes = evaluate(values)
    inside = np.ones(len(effort), dtype=np.bool_)
    for _ in range(_LEVELS):
        if np.count_nonzero(inside) < _FEWEST_SHARE * len(inside):  # too few to tell the noise
            inside = np.ones_like(inside)
        level = known or fit_noise_level((effort - predicted)[inside], predicted[inside])
        sigma = level.sigma(predicted)
        for _ in range(_STEPS):
            weights = np.clip(1.0 - ((effort - predicted) / (CUT * sigma)) ** 2, 0.0, None) / sigma
            step = solve(slopes, effort - predicted, weights).gains
            settled = float(np.abs(weights * (slopes @ step)).max()) * np.sqrt(len(effort)) < _SETTLED
            values = values + step
            predicted, slopes = evaluate(values)
            if settled:
                break
        inside = np.abs(effort - predicted) < _INSIDE * sigma
    return IrlsResult(values, slopes, effort - predicted, sigma, level)
