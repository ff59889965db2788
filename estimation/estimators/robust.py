"""MM estimation: takes up to half of the samples being wrong, and loses little where none is."""

import numpy as np

from estimation.estimate import Estimate
from estimation.estimator import Estimator
from estimation.least_squares import solve
from estimation.loss import Loss
from estimation.noise_level import NoiseLevel, fit_noise_level
from estimation.regression import Regression
from estimation.subsets import solve_subsets
from estimation.uncertainty import assemble, sandwich
from robot_io.types import FloatArray

_CUT = 4.685  # of the biweight, in sigmas: 95 % efficient at Gaussian noise
_STARTS = 500  # subsets of the start: one of p = 4 is clean at 40 % outliers with probability 1 - 1e-30
_START_SAMPLES = 2000  # samples on which the starts are compared
_ROUNDS = 50
_TOLERANCE = 1e-10


class Robust(Estimator):
    """Biweight M-estimate from a high-breakdown start, with weights that follow the noise.

    The start is the least median of squares over random subsets; the scale is the residuals' floor plus a
    share of the predicted effort (see `NoiseLevel`), so that a force sensor whose noise grows with the force
    is weighted as it deserves. Where the regression brings its own sigma, only its factor is estimated.
    """

    name = "robust"
    summary = (
        "MM estimate with noise-proportional weights: the one to take when nothing is known about the noise"
    )
    source = (
        "V. J. Yohai, High Breakdown-Point and High Efficiency Robust Estimates for Regression, "
        "Ann. Stat. 15 (1987)"
    )
    loss = Loss.CAUCHY

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        """See `Estimator.fit`."""
        gains = _least_median(regression, rng)
        for _ in range(_ROUNDS):
            residuals = regression.effort - regression.columns @ gains
            sigma, _ = _sigma(regression, residuals)
            weights = np.sqrt(_biweight(residuals / sigma)) / sigma
            before, gains = gains, solve(regression.columns, regression.effort, weights).gains
            if np.all(np.abs(gains - before) <= _TOLERANCE * np.abs(gains).max()):
                break
        residuals = regression.effort - regression.columns @ gains
        sigma, noise = _sigma(regression, residuals)
        psi, slope = _influence(residuals / sigma)
        return assemble(
            self.name,
            regression.names,
            regression.units,
            gains,
            jacobian=regression.columns,
            effort=regression.effort,
            residuals=residuals,
            covariance=sandwich(regression.columns, psi / sigma, slope / sigma**2, regression.run),
            inliers=np.abs(residuals) < _CUT * sigma,
            details={"noise_floor": noise.floor, "noise_share": noise.share},
        )


def _influence(standardised: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Psi of the biweight and its slope, each of shape (n,)."""
    square = np.minimum((standardised / _CUT) ** 2, 1.0)
    return standardised * (1 - square) ** 2, (1 - square) * (1 - 5 * square)


def _biweight(standardised: FloatArray) -> FloatArray:
    """Tukey's weights psi(u) / u, shape (n,)."""
    weights: FloatArray = np.clip(1 - (standardised / _CUT) ** 2, 0.0, None) ** 2
    return weights


def _sigma(regression: Regression, residuals: FloatArray) -> tuple[FloatArray, NoiseLevel]:
    """Noise of each sample, shape (n,), and the level it comes from."""
    if regression.sigma is not None:
        shape = 1.0 / regression.weights
        level = fit_noise_level(residuals / shape, np.zeros(len(residuals)))
        return level.floor * shape, level
    predicted = regression.effort - residuals
    level = fit_noise_level(residuals, predicted)
    return level.sigma(predicted), level


def _least_median(regression: Regression, rng: np.random.Generator) -> FloatArray:
    """Gains of the subset whose median absolute weighted residual is smallest, shape (p,)."""
    weights = regression.weights
    columns, effort = regression.columns * weights[:, None], regression.effort * weights
    candidates = solve_subsets(columns, effort, columns.shape[1], _STARTS, rng).gains
    rows = rng.permutation(len(effort))[:_START_SAMPLES]
    distance = np.abs(candidates @ columns[rows].T - effort[rows])
    middle = distance.shape[1] // 2
    medians = np.partition(distance, middle, axis=1)[:, middle]
    best: FloatArray = candidates[int(np.argmin(medians))]
    return best
