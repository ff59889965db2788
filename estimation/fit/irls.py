"""Robust fits: loss functions, and iteratively reweighted least squares for linear and nonlinear models.

After every two steps, the noise level is estimated again from samples with small residuals. From a nearby
start, a few steps are as efficient as the fully iterated estimate (D. G. Simpson, D. Ruppert, R. J. Carroll,
On One-Step GM Estimates and Stability of Inferences in Linear Regression, JASA 87 (1992)).
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palpate.estimation.statistics.least_squares import solve
from palpate.estimation.statistics.noise import NoiseLevel, fit_noise_level, robust_sigma
from palpate.robot_io.types import BoolArray, FloatArray

CUT = 5.5  # cutoff of the biweight in sigmas: 97.5 % efficient for Gaussian noise
_CAUCHY_CUT = 2.385  # cutoff of Cauchy's weight in sigmas: 95 % efficient for Gaussian noise
_MIN_RESIDUAL = 0.05  # least absolute residual in sigmas, which keeps 1 / |residual| finite
_MIN_SIGMA = 1e-100  # least noise in any unit, so that the inverse of its square is finite
_INLIER_SIGMAS = 4.0  # residuals above this number of sigmas are not used to estimate the noise
_LEVELS = 3  # number of noise level estimates
_STEPS = 2  # number of reweighted fits for each noise level
_CONVERGED = 1e-4  # change in standard errors that ends the iteration
_MIN_SHARE = 0.05  # share of samples needed to estimate the noise

Evaluate = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function of parameters (p,) that returns the predicted effort (n,) and its derivatives (n, p)."""


class Loss(StrEnum):
    """Loss of a standardized residual u."""

    LINEAR = "linear"  # u^2 / 2: least squares
    CAUCHY = "cauchy"  # grows with log u: robust against outliers
    BIWEIGHT = "biweight"  # Cauchy's loss, followed by a few biweight steps that exclude outliers, see `irls`


def cauchy_influence(standardized: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Cauchy's weight psi(u) / u and the derivative of psi, each of shape (n,).

    Args:
        standardized: residuals u divided by their scale, shape (n,).
    """
    square = (standardized / _CAUCHY_CUT) ** 2
    return 1.0 / (1.0 + square), (1.0 - square) / (1.0 + square) ** 2


def absolute_loss_weights(residuals: FloatArray) -> FloatArray:
    """Return squared weights of the least-squares step that minimizes absolute residuals, shape (n,).

    Args:
        residuals: residuals of the previous step, shape (n,).
    """
    smallest = max(_MIN_RESIDUAL * robust_sigma(residuals), _MIN_SIGMA)
    return np.asarray(1.0 / np.maximum(np.abs(residuals), smallest))


@dataclass(frozen=True)
class IrlsResult:
    """Result of iteratively reweighted least squares."""

    values: FloatArray  # parameters, shape (p,)
    slopes: FloatArray  # derivatives of the prediction by the parameters, shape (n, p)
    residuals: FloatArray  # effort minus prediction, shape (n,)
    sigma: FloatArray  # standard deviation of the noise of each sample, shape (n,)
    level: NoiseLevel  # noise level from which `sigma` was computed

    @property
    def inside(self) -> BoolArray:
        """Mask of the samples with nonzero weight, shape (n,)."""
        return np.abs(self.residuals) < CUT * self.sigma

    @property
    def influence(self) -> tuple[FloatArray, FloatArray]:
        """Psi of the standardized residuals and its derivative, each of shape (n,)."""
        standardized = self.residuals / self.sigma
        square = np.minimum((standardized / CUT) ** 2, 1.0)
        return standardized * (1 - square) ** 2, (1 - square) * (1 - 5 * square)


def biweight_loss(standardized: FloatArray) -> FloatArray:
    """Return Tukey's biweight loss of residuals, from 0 to 1 where they have no weight, shape (n,).

    Args:
        standardized: residuals, relative to the standard deviation of the noise, shape (n,).
    """
    return np.asarray(1.0 - np.clip(1.0 - (standardized / CUT) ** 2, 0.0, None) ** 3)


def irls(
    evaluate: Evaluate, effort: FloatArray, start: FloatArray, known: NoiseLevel | None = None
) -> IrlsResult:
    """Compute an M-estimate by iteratively reweighted least squares.

    Args:
        evaluate: the model, see `Evaluate`.
        effort: measured effort, shape (n,).
        start: start values of the parameters, which must fit most samples, shape (p,).
        known: noise level if known; None to estimate it from the residuals.
    """
    values = start
    predicted, slopes = evaluate(values)
    inside = np.ones(len(effort), dtype=np.bool_)
    for _ in range(_LEVELS):
        if np.count_nonzero(inside) < _MIN_SHARE * len(inside):  # too few to estimate the noise
            inside = np.ones_like(inside)
        level = known or fit_noise_level((effort - predicted)[inside], predicted[inside])
        sigma = level.sigma(predicted)
        for _ in range(_STEPS):
            weights = np.clip(1.0 - ((effort - predicted) / (CUT * sigma)) ** 2, 0.0, None) / sigma
            step = solve(slopes, effort - predicted, weights)
            has_converged = float(np.abs(weights * (slopes @ step)).max()) * np.sqrt(len(effort)) < _CONVERGED
            values = values + step
            predicted, slopes = evaluate(values)
            if has_converged:
                break
        inside = np.abs(effort - predicted) < _INLIER_SIGMAS * sigma
    return IrlsResult(values, slopes, effort - predicted, sigma, level)
