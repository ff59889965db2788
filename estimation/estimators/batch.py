"""Least squares over all samples at once: plain, weighted and robust."""

import numpy as np

from palpate.estimation.assessment import assemble
from palpate.estimation.estimate import Estimate
from palpate.estimation.estimator import Estimator
from palpate.estimation.fit.irls import IrlsResult, Loss, absolute_loss_weights, biweight_loss, irls
from palpate.estimation.model import Regression
from palpate.estimation.statistics.least_squares import solve, solve_subsets
from palpate.estimation.statistics.noise import NoiseLevel, fit_noise_level, robust_sigma
from palpate.estimation.statistics.uncertainty import sandwich
from palpate.robot_io.types import FloatArray


class Lsq(Estimator):
    """Minimize the sum of squared residuals.

    Source: the paper, eq. (2), solved by the pseudo-inverse.
    """

    name = "lsq"

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        gains = solve(regression.columns, regression.effort)
        residuals = regression.effort - regression.columns @ gains
        covariance = sandwich(regression.columns, residuals, np.ones(len(residuals)), regression.run)
        return assemble(self.name, regression, gains, covariance)


_ROUNDS = 5  # the weights depend only weakly on the gains and have converged by then


class Weighted(Estimator):
    """Iterated weighted least squares for noise that grows with the predicted effort (weights 1/sigma).

    The weights use the predicted effort. The measured effort would favor samples whose noise happens to be
    negative.

    Source: R. J. Carroll, D. Ruppert, Transformation and Weighting in Regression (1988), ch. 2.
    """

    name = "weighted"

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        weights = np.ones(len(regression.effort))
        for _ in range(_ROUNDS):
            gains = solve(regression.columns, regression.effort, weights)
            predicted = regression.columns @ gains
            residuals = regression.effort - predicted
            noise = fit_noise_level(residuals, predicted)
            weights = 1.0 / noise.sigma(predicted)
        squared = weights**2
        covariance = sandwich(regression.columns, squared * residuals, squared, regression.run)
        details = {"noise_floor": noise.floor, "noise_share": noise.share}
        return assemble(self.name, regression, gains, covariance, details=details)


_SUBSETS = 150  # random subsets; for 4 gains and 40 % outliers, none is clean with probability 1e-9
_RANKING_SAMPLES = 400  # samples on which the fits to the subsets are compared
_LAD_ROUNDS = 15  # iterations of the fit of least absolute deviations
_MIN_INLIER_SHARE = 0.55  # with fewer inliers, the model is wrong and the rejected samples are no outliers


class Robust(Estimator):
    """Biweight M-estimate from a high-breakdown start, with weights that follow the noise.

    The start is the least median of squares over random subsets. The scale is a noise floor plus a share of
    the predicted effort (see `NoiseLevel`), so that a force sensor whose noise grows with the force is
    weighted correctly.

    Such a start can fit most samples perfectly, for example a long rest, and reject the others as outliers.
    The fit of least absolute residuals, which uses all samples, is therefore a second start, and the estimate
    with the smaller loss counts. If it rejects 45 % of the samples, the model is wrong. The fit is then
    repeated from the second start, with the noise level of the least absolute residuals.

    Source: V. J. Yohai, High Breakdown-Point and High Efficiency Robust Estimates for Regression, Ann. Stat.
    15 (1987).
    """

    name = "robust"
    loss = Loss.BIWEIGHT

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        # Choose the gains of the subset with the smallest median absolute residual, shape (p,).
        columns, effort = regression.columns, regression.effort
        candidates = solve_subsets(columns, effort, columns.shape[1], _SUBSETS, rng)
        rows = rng.permutation(len(effort))[:_RANKING_SAMPLES]
        distance = np.abs(candidates @ columns[rows].T - effort[rows])
        middle = distance.shape[1] // 2
        medians = np.partition(distance, middle, axis=1)[:, middle]
        best: FloatArray = candidates[int(np.argmin(medians))]
        # Gains (p,) that nearly minimize the sum of absolute residuals.
        residual_weights = np.ones(len(effort))
        for _ in range(_LAD_ROUNDS):
            gains = solve(columns, effort, np.sqrt(residual_weights))
            residual = effort - columns @ gains
            residual_weights = absolute_loss_weights(residual)
        results = [_irls(regression, start) for start in (best, gains)]
        sigma = results[0].sigma
        result = min(results, key=lambda result: float(np.mean(biweight_loss(result.residuals / sigma))))
        if result.inside.mean() < _MIN_INLIER_SHARE:
            level = NoiseLevel(max(robust_sigma(residual), float(np.finfo(float).tiny)), 0.0)
            result = _irls(regression, gains, level)
        (psi, slope), sigma = result.influence, result.sigma
        covariance = sandwich(regression.columns, psi / sigma, slope / sigma**2, regression.run)
        details = {"noise_floor": result.level.floor, "noise_share": result.level.share}
        return assemble(
            self.name, regression, result.values, covariance, inliers=result.inside, details=details
        )


def _irls(regression: Regression, start: FloatArray, level: NoiseLevel | None = None) -> IrlsResult:
    columns = regression.columns
    return irls(lambda gains: (columns @ gains, columns), regression.effort, start, level)
