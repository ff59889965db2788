"""Fits a model to a channel and says how sure each parameter is."""

from dataclasses import dataclass

import numpy as np

from estimation.channel import ChannelData
from estimation.estimate import Estimate
from estimation.fitting.loss import Loss
from estimation.fitting.problem import NO_BOUNDS, Bounds, Problem
from estimation.fitting.search import Solution, search
from estimation.fitting.search_nonlinear import search_nonlinear
from estimation.model import Model, Parameters
from estimation.statistics.uncertainty import Covariance, assemble, sandwich
from robot_io.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Fit:
    """A model with its parameters.

    Attributes:
        model: what was fitted.
        parameters: gains, then inner parameters, by "effect.parameter".
        covariance: of the parameters in that order; NaN for an inner parameter that ended at its bound, if
            that is not one of `Problem.within`.
        unbounded: the same as if there were no bounds: a bound is no measurement.
        residuals: effort minus prediction, shape (n,), also of samples that were not fitted.
        rows: samples that were fitted, shape (n,).
        jacobian: slopes of the prediction in those samples, one column for each parameter.
        estimate: the same with intervals and a judgement; its arrays hold the fitted samples only.
    """

    model: Model
    parameters: dict[str, float]
    covariance: Covariance
    unbounded: Covariance
    residuals: FloatArray
    rows: BoolArray
    jacobian: FloatArray
    estimate: Estimate

    @property
    def rmse(self) -> float:
        """Root mean square of the residuals of the fitted samples."""
        return float(np.sqrt(np.mean(self.residuals[self.rows] ** 2)))

    def predict(self, data: ChannelData) -> FloatArray:
        """Effort that the fitted model expects for other data, shape (n,)."""
        return self.model.predict(data, self.parameters)


def fit(
    model: Model,
    data: ChannelData,
    *,
    rows: BoolArray | None = None,
    sigma: FloatArray | None = None,
    loss: Loss = Loss.LINEAR,
    start: Parameters | None = None,
    within: Bounds = NO_BOUNDS,
) -> Fit:
    """Fit all parameters of a model together.

    Args:
        model: what to fit.
        data: whole runs of the channel; effects with memory see all of it.
        rows: samples whose residuals count, shape (n,); None for all.
        sigma: noise of each sample, shape (n,), up to a common factor; None for equal.
        loss: `Loss.CAUCHY` or `Loss.BIWEIGHT` where some samples may be wrong.
        start: inner parameters to begin with; None to try those that the effects propose.
        within: see `Problem`.

    Raises:
        InputError: there are fewer samples than parameters.
    """
    problem = Problem(model, data, rows, sigma, within)
    find = search if model.is_linear_in_gains else search_nonlinear
    solution = find(problem, loss, start)
    return describe(problem, solution, loss)


def describe(problem: Problem, solution: Solution, loss: Loss) -> Fit:
    """A fit from where a search ended, with the standard errors of all parameters together."""
    gains, vector, rows = solution.gains, solution.vector, problem.rows
    parameters = problem.parameters(gains, vector)
    residuals = problem.residuals(gains, vector)
    rates = np.concatenate([np.ones(len(gains)), problem.scale.rates(vector)])
    jacobian = problem.slopes(gains, vector)[rows] / rates
    narrowed = np.array([name in problem.within for name in problem.model.inner], dtype=np.bool_)
    free = np.concatenate([np.ones(len(gains), dtype=np.bool_), narrowed | ~problem.scale.at_bound(vector)])
    score, slope = _influence(problem, solution, loss, residuals[rows])
    run = problem.data.run[rows]
    unbounded = sandwich(jacobian, score, slope, run)
    if not np.isfinite(unbounded.matrix).all():
        unbounded = _spread_out(sandwich(jacobian[:, free], score, slope, run), free)
    covariance = _without(unbounded, ~free)
    estimate = assemble(
        "fit",
        tuple(parameters),
        problem.model.units(problem.data),
        np.array(list(parameters.values())),
        jacobian=jacobian,
        effort=problem.data.effort[rows],
        residuals=residuals[rows],
        covariance=covariance,
        details={"noise": solution.noise},
    )
    return Fit(problem.model, parameters, covariance, unbounded, residuals, rows, jacobian, estimate)


def _influence(
    problem: Problem, solution: Solution, loss: Loss, residuals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Score and slope of each residual, see `sandwich`."""
    if (settled := solution.settled) is not None:
        psi, slope = settled.influence
        return psi / settled.sigma, slope / settled.sigma**2
    weights = problem.weights
    standardised = weights * residuals / max(solution.noise, np.finfo(float).tiny)
    return weights**2 * loss.weight(standardised) * residuals, weights**2 * loss.slope(standardised)


def _without(covariance: Covariance, fixed: BoolArray) -> Covariance:
    """The covariance with NaN for those that ended at a bound."""
    matrix = covariance.matrix.copy()
    matrix[fixed, :] = matrix[:, fixed] = np.nan
    return Covariance(matrix, covariance.degrees_of_freedom)


def _spread_out(covariance: Covariance, free: BoolArray) -> Covariance:
    """The covariance of all parameters, NaN for those that were not free."""
    matrix = np.full((len(free), len(free)), np.nan)
    matrix[np.ix_(free, free)] = covariance.matrix
    return Covariance(matrix, covariance.degrees_of_freedom)
