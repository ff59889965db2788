"""Finds gains and inner parameters: gains by linear least squares inside a bounded search for the others.

Variable projection: G. H. Golub, V. Pereyra, Separable Nonlinear Least Squares, Inverse Problems 19 (2003).
Outliers are weighted down by iteration (P. W. Holland, R. E. Welsch, Robust Regression Using Iteratively
Reweighted Least-Squares, Comm. Stat. 6 (1977)), first by absolute residuals, whose minimum does not depend on
the start.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from estimation.fitting.loss import Loss, absolute_share
from estimation.fitting.m_steps import Settled, settle
from estimation.fitting.problem import STEP, Problem
from estimation.model import Parameters
from estimation.regression import Regression
from estimation.statistics.least_squares import solve
from estimation.statistics.noise_level import robust_sigma
from robot_io.types import FloatArray

_ROUNDS = 40
_ABSOLUTE_ROUNDS = 5
_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Solution:
    """Where a search ended.

    Attributes:
        gains: shape (p,).
        vector: inner parameters on their search scale, shape (q,).
        noise: standard deviation of the weighted residuals' core, in the effort's unit.
        settled: the same with the noise of each sample, if the search ended with `m_steps`; else None.
    """

    gains: FloatArray
    vector: FloatArray
    noise: float
    settled: Settled | None = None


def search(problem: Problem, loss: Loss = Loss.LINEAR, start: Parameters | None = None) -> Solution:
    """Minimise the loss of the weighted residuals.

    Args:
        problem: what to fit; its model must be linear in its gains.
        loss: of residuals.
        start: inner parameters to begin with; None to try those that the effects propose.

    Raises:
        InputError: the model is not linear in its gains, or there are too few samples.
    """
    scale = problem.scale
    vector = _scan(problem, loss) if start is None else scale.vector(start)
    weights = problem.regression(vector).weights
    if loss is Loss.LINEAR:
        vector = _descend(problem, vector, weights)
        gains, residuals = _project(problem.regression(vector), weights)
        return Solution(gains, vector, float(np.sqrt(np.mean((weights * residuals) ** 2))))
    found = _reweight(problem, Loss.CAUCHY, vector, weights)
    return found if loss is Loss.CAUCHY else _settle(problem, found)


def _settle(problem: Problem, found: Solution) -> Solution:
    """From a solution that stands outliers to the efficient one near it; what is at a bound stays there."""
    count, rows = len(found.gains), problem.rows
    lower, upper = problem.scale.bounds
    fixed = np.concatenate([np.zeros(count, dtype=np.bool_), problem.scale.at_bound(found.vector)])

    def evaluate(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        gains, vector = values[:count], np.clip(values[count:], lower, upper)
        slopes = problem.slopes(gains, vector)[rows]
        slopes[:, fixed] = 0.0
        return effort - problem.residuals(gains, vector)[rows], slopes

    effort = problem.data.effort[rows]
    shape = None if problem.sigma is None else 1.0 / problem.weights
    settled = settle(evaluate, effort, np.concatenate([found.gains, found.vector]), shape)
    vector = np.clip(settled.values[count:], lower, upper)
    noise = robust_sigma(problem.weights * settled.residuals)
    return Solution(settled.values[:count], vector, noise, settled)


def _scan(problem: Problem, loss: Loss) -> FloatArray:
    """The best of the starts that each effect proposes, one effect after the other."""
    values = {name: float(parameter.spread(3)[1]) for name, parameter in problem.model.inner.items()}
    for effect in problem.model.effects:
        if effect.inner:
            proposals = [
                values | {f"{effect.name}.{name}": value for name, value in start.items()}
                for start in effect.starts(problem.data)
            ]
            values = min(proposals, key=lambda proposal: _cost(problem, loss, proposal))
    return problem.scale.vector(values)


def _cost(problem: Problem, loss: Loss, values: Parameters) -> float:
    """What these inner parameters leave: mean square, or mean absolute residual if the loss is robust."""
    regression = problem.regression(problem.scale.vector(values))
    weights = regression.weights
    _, residuals = _project(regression, weights)
    if loss is Loss.LINEAR:
        return float(np.mean((weights * residuals) ** 2))
    for _ in range(_ABSOLUTE_ROUNDS):
        _, residuals = _project(regression, weights * np.sqrt(absolute_share(weights * residuals)))
    return float(np.mean(np.abs(weights * residuals)))


def _project(regression: Regression, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The best gains (p,) for these weights, and the residuals (n,) that they leave."""
    gains = solve(regression.columns, regression.effort, weights).gains
    return gains, regression.effort - regression.columns @ gains


def _reweight(problem: Problem, loss: Loss, vector: FloatArray, weights: FloatArray) -> Solution:
    """Repeat the search with weights from the residuals of the one before."""
    gains, residuals = _project(problem.regression(vector), weights)
    for number in range(_ROUNDS):
        noise = max(robust_sigma(weights * residuals), np.finfo(float).tiny)
        absolute = number < _ABSOLUTE_ROUNDS
        share = absolute_share(weights * residuals) if absolute else loss.weight(weights * residuals / noise)
        before = gains, vector
        vector = _descend(problem, vector, weights * np.sqrt(share))
        gains, residuals = _project(problem.regression(vector), weights * np.sqrt(share))
        if not absolute and _settled(before, (gains, vector)):
            break
    return Solution(gains, vector, noise)


def _settled(before: tuple[FloatArray, FloatArray], after: tuple[FloatArray, FloatArray]) -> bool:
    moved = np.abs(after[0] - before[0]) <= _TOLERANCE * np.abs(after[0]).max(initial=0.0)
    return bool(moved.all() and np.abs(after[1] - before[1]).max(initial=0.0) <= _TOLERANCE)


def _descend(problem: Problem, vector: FloatArray, weights: FloatArray) -> FloatArray:
    """Inner parameters at the nearest minimum of the weighted squares, shape (q,)."""
    if not len(vector):
        return vector

    def residuals(at: FloatArray) -> FloatArray:
        return weights * _project(problem.regression(at), weights)[1]

    lower, upper = problem.scale.bounds

    def jacobian(at: FloatArray) -> FloatArray:
        here = residuals(at)
        columns = []
        for index in range(len(at)):
            step = np.zeros_like(at)
            step[index] = STEP if at[index] + STEP < upper[index] else -STEP
            columns.append((residuals(at + step) - here) / step[index])
        return np.column_stack(columns)

    found = least_squares(residuals, vector, jacobian, (lower, upper), xtol=_TOLERANCE, ftol=1e-10, gtol=None)
    return np.asarray(found.x)
