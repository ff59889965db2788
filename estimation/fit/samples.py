"""Fit a model to single samples of a channel, some of which may be outliers; estimators use it.

Gains follow by variable projection inside a bounded search for the inner parameters (`optimize_inner`).
Iteratively reweighted least squares reduces the weight of outliers (P. W. Holland, R. E. Welsch, Robust
Regression Using Iteratively Reweighted Least-Squares, Comm. Stat. 6 (1977)). It starts with absolute
residuals, whose minimum does not depend on the start.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.fit_problem import FitProblem, Solution, solve_gains
from palpate.estimation.fit.inner_search import optimize_inner
from palpate.estimation.fit.irls import Loss, absolute_loss_weights, cauchy_influence, irls
from palpate.estimation.fit.normal_equations import WHITE
from palpate.estimation.model import Model
from palpate.estimation.statistics.noise import robust_sigma
from palpate.estimation.statistics.uncertainty import Covariance, sandwich
from palpate.robot_io.types import BoolArray, FloatArray

_ROUNDS = 40
_LAD_ROUNDS = 5
_TOLERANCE = 1e-7
_STEP = 1e-5  # step of finite differences, relative to an inner parameter's value or typical range
_MARGIN = 1e-3  # least distance of a start value from a bound, relative to the range


@dataclass(frozen=True)
class SampleFit:
    """A model fitted to samples, with parameters, covariance and residuals."""

    model: Model  # the fitted model
    parameters: dict[str, float]  # gains, then inner parameters, by "effect.parameter"
    # Covariance of the parameters in this order; NaN for an inner parameter at a search bound, unless the
    # bound is in `Model.within`.
    covariance: Covariance
    unbounded: Covariance  # covariance computed as if there were no bounds
    residuals: FloatArray  # effort minus prediction in the fitted samples
    jacobian: FloatArray  # derivatives of the prediction in these samples, one column per parameter


def fit_samples(
    model: Model,
    data: ChannelData,
    rows: BoolArray | None = None,
    loss: Loss = Loss.LINEAR,
    searched: dict[bool, Solution] | None = None,
) -> SampleFit:
    """Fit all parameters of a model jointly.

    Args:
        model: model to fit.
        data: whole runs of the channel, since effects with memory need all samples.
        rows: mask of the samples to fit, shape (n,); None for all.
        loss: loss function; `Loss.CAUCHY` and `Loss.BIWEIGHT` are robust against outliers.
        searched: results of earlier searches on these samples, without their blocks, by whether they are
            robust; extended here.
    """
    count = len(data)
    used = np.ones(count, dtype=np.bool_) if rows is None else rows
    problem = FitProblem(
        BlockedData(data, np.arange(count)[:, None], data.run, np.zeros(count, dtype=np.int64), used), WHITE
    )
    searched, robust = {} if searched is None else searched, loss is not Loss.LINEAR
    if robust not in searched:
        # Select the best start values of each effect, one effect after the other.
        inner = {name: float(parameter.spread(3)[1]) for name, parameter in model.inner.items()}
        start_solution = solve_gains(problem, model, _inside(model, inner))
        for effect in model.effects:
            if effect.inner:
                proposals = [
                    inner | {f"{effect.name}.{name}": value for name, value in start.items()}
                    for start in effect.starts(problem.blocked.data)
                ]
                # A list would keep the columns of all proposals in memory.
                solutions = (solve_gains(problem, model, _inside(model, proposal)) for proposal in proposals)
                start_solution = min(solutions, key=lambda start: _cost(problem, start, loss))
                inner = {name: start_solution.parameters[name] for name in model.inner}
        search = _reweighted if robust else _optimize_precisely
        searched[robust] = search(problem, start_solution).without_blocks()
    return _with_covariance(searched[robust], problem, loss)


def slopes_of(model: Model, data: ChannelData, parameters: Mapping[str, float]) -> FloatArray:
    """Return the derivatives of the prediction by all gains and inner parameters, shape (n, p + q).

    Args:
        model: the model.
        data: the channel.
        parameters: values by "effect.parameter".
    """
    by_gain, _ = model.linearize(data, parameters)
    return np.column_stack([by_gain, *model.inner_slopes(data, parameters, _STEP)])


def _optimize_precisely(problem: FitProblem, solution: Solution) -> Solution:
    return optimize_inner(problem, solution, tolerance=1e-10, step=_STEP)


def _inside(model: Model, inner: Mapping[str, float]) -> dict[str, float]:
    """Return inner parameters moved away from their bounds, where a search would get stuck."""
    inside = {}
    for name, value in inner.items():
        low, high = model.inner[name].lower, model.inner[name].upper
        margin = _MARGIN * (high - low)
        inside[name] = float(np.clip(value, low + margin, high - margin))
    return inside


def _cost(problem: FitProblem, solution: Solution, loss: Loss) -> float:
    """Return the loss at these inner parameters: sum of squares, or mean absolute residual if robust."""
    if loss is Loss.LINEAR:
        return solution.sse
    parts = solution.model.parts(problem.blocked.data, solution.parameters)
    for _ in range(_LAD_ROUNDS):
        weighted = _weighted(problem, absolute_loss_weights(solution.residual[problem.used]))
        solution = solve_gains(weighted, solution.model, solution.parameters, parts=parts)
    return float(np.mean(np.abs(solution.residual[problem.used])))


def _reweighted(problem: FitProblem, solution: Solution) -> Solution:
    """Repeat the search with weights from the previous residuals: first absolute, then Cauchy's loss."""
    for number in range(_ROUNDS):
        absolute = number < _LAD_ROUNDS
        residual = solution.residual[problem.used]
        weights = (
            absolute_loss_weights(residual) if absolute else cauchy_influence(residual / _scale(residual))[0]
        )
        weighted = _weighted(problem, weights)
        search = optimize_inner if absolute else _optimize_precisely
        before, solution = solution.parameters, solve_gains(weighted, solution.model, solution.parameters)
        solution = search(weighted, solution)
        if not absolute and _has_converged(before, solution):
            break
    return solution


def _has_converged(before: Mapping[str, float], after: Solution) -> bool:
    """Check convergence: the largest change of gains and inner parameters is below a tolerance."""
    model, values = after.model, after.parameters
    size = dict.fromkeys(model.gains, max((abs(values[name]) for name in model.gains), default=0.0))
    size |= {name: inner.typical[1] - inner.typical[0] for name, inner in model.inner.items()}
    return all(abs(values[name] - before[name]) <= _TOLERANCE * size[name] for name in size)


def _weighted(problem: FitProblem, squared_weights: FloatArray) -> FitProblem:
    """Return the fit problem with these squared weights of the samples in use."""
    weights = np.zeros(len(problem.blocked))
    weights[problem.used] = np.sqrt(squared_weights)
    return replace(problem, weights=weights)


def _scale(residuals: FloatArray) -> float:
    return max(robust_sigma(residuals), float(np.finfo(float).tiny))


def _named(model: Model, values: FloatArray) -> dict[str, float]:
    """Return parameters by name, with inner parameters clipped to their bounds."""
    named = dict(zip((*model.gains, *model.inner), values.tolist(), strict=True))
    return named | {n: float(np.clip(named[n], p.lower, p.upper)) for n, p in model.inner.items()}


def _with_covariance(solution: Solution, problem: FitProblem, loss: Loss) -> SampleFit:
    """Add the joint covariance of all parameters; for the biweight, refine the parameters first."""
    model, data, rows = solution.model, problem.blocked.data, problem.used
    parameters = solution.parameters
    if loss is Loss.BIWEIGHT:  # compute the efficient solution near the robust one
        at_bound = [model.at_bound(name, value) for name, value in parameters.items()]

        def evaluate(values: FloatArray) -> tuple[FloatArray, FloatArray]:
            named = _named(model, values)
            slopes = slopes_of(model, data, named)[rows]
            slopes[:, at_bound] = 0.0  # a parameter at a bound stays there
            return model.predict(data, named)[rows], slopes

        result = irls(evaluate, data.effort[rows], np.array(list(parameters.values())))
        parameters = _named(model, result.values)
        psi, slope = result.influence
        score, slope = psi / result.sigma, slope / result.sigma**2
    residuals = (data.effort - model.predict(data, parameters))[rows]
    if loss is Loss.LINEAR:
        score, slope = residuals, np.ones(len(residuals))
    elif loss is Loss.CAUCHY:
        weight, slope = cauchy_influence(residuals / _scale(residuals))
        score = weight * residuals
    jacobian = slopes_of(model, data, parameters)[rows]
    free = np.array(
        [n not in model.inner or n in model.within or not model.at_bound(n, v) for n, v in parameters.items()]
    )
    unbounded = sandwich(jacobian, score, slope, data.run[rows])
    if not np.isfinite(unbounded.matrix).all():
        determined = sandwich(jacobian[:, free], score, slope, data.run[rows])
        matrix = np.full((len(free), len(free)), np.nan)
        matrix[np.ix_(free, free)] = determined.matrix
        unbounded = Covariance(matrix, determined.degrees_of_freedom)
    matrix = unbounded.matrix.copy()
    matrix[~free, :] = matrix[:, ~free] = np.nan  # parameters at a search bound
    bounded = Covariance(matrix, unbounded.degrees_of_freedom)
    return SampleFit(model, parameters, bounded, unbounded, residuals, jacobian)
