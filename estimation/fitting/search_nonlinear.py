"""Finds all parameters together where the effort is not linear in the gains, as behind a saturated sensor."""

import numpy as np
from scipy.optimize import least_squares

from estimation.effect import Effect, SensorEffect
from estimation.fitting.loss import CAUCHY_CUT, Loss
from estimation.fitting.problem import Problem
from estimation.fitting.search import Solution, search
from estimation.model import Model, Parameters
from estimation.statistics.noise_level import robust_sigma
from robot_io.types import FloatArray

_TRIAL_STEPS = 6  # enough to see which start is best


def search_nonlinear(problem: Problem, loss: Loss = Loss.LINEAR, start: Parameters | None = None) -> Solution:
    """Minimise the loss of the weighted residuals over gains and inner parameters; see `search`.

    The gains begin where the model without its nonlinear sensors has them.
    """
    bare = Problem(_without_bends(problem.model), problem.data, problem.rows, problem.sigma)
    begun = search(bare, loss, start)
    inner = bare.scale.values(begun.vector)
    tries = _starts(problem, inner) if start is None else [start]
    vectors = [problem.scale.vector(values) for values in tries]
    best = vectors[0]
    if len(vectors) > 1:
        ends = [_descend(problem, loss, Solution(begun.gains, v, begun.noise), _TRIAL_STEPS) for v in vectors]
        best = vectors[int(np.argmin([end.noise for end in ends]))]
    return _descend(problem, loss, Solution(begun.gains, best, begun.noise), None)


def _bends(effect: Effect) -> bool:
    return isinstance(effect, SensorEffect) and not effect.linear


def _without_bends(model: Model) -> Model:
    return Model(model.name, tuple(effect for effect in model.effects if not _bends(effect)))


def _starts(problem: Problem, inner: Parameters) -> list[Parameters]:
    """What the nonlinear sensors propose, each with the others' middle values."""
    middle = {name: float(parameter.spread(3)[1]) for name, parameter in problem.model.inner.items()}
    return [
        {**middle, **inner, **{f"{effect.name}.{name}": value for name, value in start.items()}}
        for effect in problem.model.effects
        if _bends(effect)
        for start in effect.starts(problem.data)
    ]


def _descend(problem: Problem, loss: Loss, start: Solution, steps: int | None) -> Solution:
    """The nearest minimum, or how far `steps` evaluations come towards it."""
    size = np.where(start.gains != 0.0, np.abs(start.gains), 1.0)
    count, weights, rows = len(size), problem.weights, problem.rows

    def residuals(at: FloatArray) -> FloatArray:
        return weights * problem.residuals(at[:count] * size, at[count:])[rows]

    def slopes(at: FloatArray) -> FloatArray:
        jacobian = problem.slopes(at[:count] * size, at[count:])[rows]
        jacobian[:, :count] *= size
        return -weights[:, None] * jacobian

    lower, upper = problem.scale.bounds
    free = np.full(count, np.inf)
    found = least_squares(
        residuals,
        np.concatenate([start.gains / size, start.vector]),
        slopes,
        (np.concatenate([-free, lower]), np.concatenate([free, upper])),
        loss=(loss if loss is Loss.LINEAR else Loss.CAUCHY).value,
        f_scale=CAUCHY_CUT * max(start.noise, np.finfo(float).tiny),
        max_nfev=steps,
    )
    left = residuals(found.x)
    noise = float(np.sqrt(np.mean(left**2))) if loss is Loss.LINEAR else robust_sigma(left)
    return Solution(found.x[:count] * size, found.x[count:], noise)
