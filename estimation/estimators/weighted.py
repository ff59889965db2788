"""Least squares with weights that follow the noise."""

import numpy as np

from estimation.estimate import Estimate
from estimation.estimator import Estimator
from estimation.regression import Regression
from estimation.statistics.least_squares import solve
from estimation.statistics.noise_level import fit_noise_level
from estimation.statistics.uncertainty import sandwich

_ROUNDS = 5  # the weights depend on the gains only weakly: they have settled by then


class Weighted(Estimator):
    """Least squares, repeated with weights 1/sigma from a noise that grows with the predicted effort.

    Weights come from the prediction and not from the measured effort, since the latter would favour samples
    whose noise happens to be negative.

    Source: R. J. Carroll, D. Ruppert, Transformation and Weighting in Regression (1988), ch. 2.
    """

    name = "weighted"

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        weights = np.ones(len(regression.effort))
        for _ in range(_ROUNDS):
            gains = solve(regression.columns, regression.effort, weights).gains
            predicted = regression.columns @ gains
            residuals = regression.effort - predicted
            noise = fit_noise_level(residuals, predicted)
            weights = 1.0 / noise.sigma(predicted)
        squared = weights**2
        covariance = sandwich(regression.columns, squared * residuals, squared, regression.run)
        details = {"noise_floor": noise.floor, "noise_share": noise.share}
        return self._estimate(regression, gains, covariance, details=details)
