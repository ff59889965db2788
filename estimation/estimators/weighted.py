"""Least squares with weights that follow the noise."""

import numpy as np

from estimation.estimate import Estimate
from estimation.estimator import Estimator
from estimation.regression import Regression
from estimation.statistics.least_squares import solve
from estimation.statistics.noise_level import fit_noise_level
from estimation.statistics.uncertainty import assemble, sandwich
from robot_io.types import FloatArray

_ROUNDS = 5  # the weights depend on the gains only weakly: they have settled by then


class Weighted(Estimator):
    """Least squares, repeated with weights 1/sigma from a noise that grows with the predicted effort.

    Weights come from the prediction and not from the measured effort, since the latter would favour samples
    whose noise happens to be negative. Where the regression brings its own sigma, that one is used.
    """

    name = "weighted"
    summary = "least squares with noise-proportional weights: for clean data whose noise grows with the force"
    source = "R. J. Carroll, D. Ruppert, Transformation and Weighting in Regression (1988), ch. 2"

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        """See `Estimator.fit`."""
        weights = regression.weights
        for _ in range(_ROUNDS):
            gains = solve(regression.columns, regression.effort, weights).gains
            residuals = regression.effort - regression.columns @ gains
            weights = _weights(regression, residuals)
        squared = weights**2
        noise = fit_noise_level(residuals, regression.effort - residuals)
        return assemble(
            self.name,
            regression.names,
            regression.units,
            gains,
            jacobian=regression.columns,
            effort=regression.effort,
            residuals=residuals,
            covariance=sandwich(regression.columns, squared * residuals, squared, regression.run),
            details={"noise_floor": noise.floor, "noise_share": noise.share},
        )


def _weights(regression: Regression, residuals: FloatArray) -> FloatArray:
    if regression.sigma is not None:
        return regression.weights
    predicted = regression.effort - residuals
    return 1.0 / fit_noise_level(residuals, predicted).sigma(predicted)
