"""Least squares, the paper's baseline."""

import numpy as np

from estimation.estimate import Estimate
from estimation.estimator import Estimator
from estimation.regression import Regression
from estimation.statistics.least_squares import solve
from estimation.statistics.uncertainty import sandwich


class Lsq(Estimator):
    """Minimise the sum of squared residuals.

    Source: the paper, eq. (2), solved by the pseudo-inverse.
    """

    name = "lsq"

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        gains = solve(regression.columns, regression.effort).gains
        residuals = regression.effort - regression.columns @ gains
        covariance = sandwich(regression.columns, residuals, np.ones(len(residuals)), regression.run)
        return self._estimate(regression, gains, covariance)
