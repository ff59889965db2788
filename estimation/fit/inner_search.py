"""Search the inner parameters of one effect over a grid, and optimize all inner parameters jointly."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from palpate.estimation.effect import Effect, Parameter
from palpate.estimation.fit.fit_problem import (
    FitProblem,
    LinearizedParts,
    Solution,
    linearize_inner,
    residual_slopes,
    solve_gains,
)
from palpate.estimation.model import Model, own_parameters
from palpate.robot_io.types import FloatArray

_HALVINGS = 3
_PARABOLAS = 3
_MAX_REPEATS = 4  # largest number of joint fits while the error still falls
_REPEAT_RATIO = 0.9  # ratio of squared errors below which the joint fit is repeated
_EVALUATIONS = 40
_SSE_TOLERANCE = 1e-5
_STEP_TOLERANCE = 1e-4  # smallest step, relative to the distance from the start
_CONVERGED_RATIO = 1.0001  # largest ratio to the predicted squared error at which a step has converged
_CHANGES = (-0.3, -0.1, 0.1, 0.3)  # tried changes of inner parameters, relative to their values
_RELEASE = 1e-3  # the same for a parameter at its bound, which may depend strongly on another one
_RELEVANT = 1e-4  # least relative decrease of the squared error for which a parameter leaves its bound
_STEP = 2e-3  # step of a finite difference


@dataclass(frozen=True)
class GridSearch:
    """Solutions of one candidate effect at all tried inner parameters."""

    # First the solutions at the start values. Only the best one keeps its arrays on blocks, to save memory.
    solutions: tuple[Solution, ...]
    start_count: int  # number of solutions at start values

    @property
    def starts(self) -> tuple[Solution, ...]:
        """Solutions at the start values."""
        return self.solutions[: self.start_count]

    @property
    def best(self) -> Solution:
        """The solution with the lowest squared error."""
        return min(self.solutions, key=lambda solution: solution.sse)

    @cached_property
    def held_out(self) -> FloatArray:
        """Squared whitened residuals of each fold, with inner parameters chosen on the other folds."""
        train = np.array([solution.linear_fit.train for solution in self.solutions])
        held_out = np.array([solution.linear_fit.held_out for solution in self.solutions])
        chosen: FloatArray = held_out[np.argmin(train, axis=0), np.arange(train.shape[1])]
        return chosen

    def without_blocks(self) -> "GridSearch":
        """Return the search without the arrays on blocks."""
        return replace(self, solutions=tuple(solution.without_blocks() for solution in self.solutions))


def search_inner(
    problem: FitProblem,
    model: Model,
    name: str,
    parameters: Mapping[str, float],
    starts: Iterable[Mapping[str, float]],
) -> GridSearch:
    """Fit a model at each start value of one of its effects.

    Args:
        problem: data, noise weights and folds of the fit.
        model: the model.
        name: name of the effect whose inner parameters are searched.
        parameters: known values by "effect.parameter".
        starts: inner parameters to try, by name.
    """
    effect = model.effect(name)
    parts_at = linearize_inner(problem.blocked, model, effect, parameters)
    points = list(starts)
    solutions = (_solve_at(problem, model, effect, parameters, inner, parts_at) for inner in points)
    return grid_search(solutions, len(points))


def grid_search(solutions: Iterable[Solution], start_count: int) -> GridSearch:
    """Collect all solutions of a candidate; only the best one keeps its arrays on blocks.

    Args:
        solutions: the solutions, first those at start values.
        start_count: number of solutions at start values.
    """
    kept: list[Solution] = []
    best = 0
    for number, solution in enumerate(solutions):
        kept.append(solution)
        if number and solution.sse < kept[best].sse:
            kept[best], best = kept[best].without_blocks(), number
        elif number:
            kept[number] = solution.without_blocks()
    return GridSearch(tuple(kept), start_count)


def refine_inner(problem: FitProblem, name: str, searched: GridSearch) -> GridSearch:
    """Refine the grid of an effect's inner parameters around the best solution.

    Args:
        problem: data, noise weights and folds of the fit.
        name: name of the effect whose inner parameters are searched.
        searched: earlier search, which is extended.
    """
    solutions, model = list(searched.solutions), searched.best.model
    effect = model.effect(name)
    parts_at = linearize_inner(problem.blocked, model, effect, solutions[0].parameters)
    grid = [own_parameters(effect, solution.parameters) for solution in solutions]
    for inner in effect.inner * (1 if len(effect.inner) == 1 else 2) if len(grid) > 1 else ():
        for number in range(_HALVINGS + _PARABOLAS):
            best = min(range(len(solutions)), key=lambda i: solutions[i].sse)
            # Points that differ from the best one only in this inner parameter, in ascending order.
            other_values = {name: value for name, value in grid[best].items() if name != inner.name}
            on_line = [i for i, point in enumerate(grid) if point.items() >= other_values.items()]
            line = sorted(on_line, key=lambda i: grid[i][inner.name])
            values, index = [grid[i][inner.name] for i in line], line.index(best)
            closer = _midpoints(values, index, inner)
            if number >= _HALVINGS and 0 < index < len(line) - 1:
                near = slice(index - 1, index + 2)
                errors = [solutions[i].sse for i in line[near]]
                closer = _parabola_minimum(values[near], errors, inner) or closer
            for value in closer:
                grid.append(grid[best] | {inner.name: value})
                known = solutions[best].parameters
                solutions.append(_solve_at(problem, model, effect, known, grid[-1], parts_at))
    return grid_search(solutions, searched.start_count)


def _solve_at(  # noqa: PLR0917
    problem: FitProblem,
    model: Model,
    effect: Effect,
    parameters: Mapping[str, float],
    inner: Mapping[str, float],
    parts_at: LinearizedParts,
) -> Solution:
    values = {**parameters, **{f"{effect.name}.{name}": value for name, value in inner.items()}}
    # One step from fitted gains is sufficient to rank candidates; promising ones are fitted completely later.
    return solve_gains(problem, model, values, rounds=1, parts=parts_at(inner))


def _midpoints(values: list[float], index: int, inner: Parameter) -> list[float]:
    """Return midpoints between a grid value and its neighbors; at an end, a value at twice the last step."""
    value, closer = values[index], list[float]()
    for side, bound in ((-1, inner.lower), (1, inner.upper)):
        if 0 <= index + side < len(values):
            near = values[index + side]
            new = np.sqrt(value * near) if inner.log and value * near > 0.0 else 0.5 * (value + near)
        elif len(values) < 2:
            new = bound
        else:
            previous = values[index - side]
            by_ratio = inner.log and previous > 0.0
            new = value * (value / previous) ** 2 if by_ratio else value + 2.0 * (value - previous)
        closer.append(float(np.clip(new, inner.lower, inner.upper)))
    return [new for new in closer if new != value]


def _parabola_minimum(values: list[float], sse: list[float], inner: Parameter) -> list[float]:
    """Return the minimum of the parabola through the errors at three values; empty without a minimum."""
    by_ratio = inner.log and values[0] > 0.0
    x = np.log(values) if by_ratio else np.array(values)
    low, middle, high = sse
    left, right = x[1] - x[0], x[2] - x[1]
    curvature = (low - middle) * right + (high - middle) * left
    if not curvature > 0.0:
        return []
    minimum = x[1] + 0.5 * ((low - middle) * right**2 - (high - middle) * left**2) / curvature
    return [float(np.exp(minimum) if by_ratio else minimum)]


@dataclass(frozen=True)
class _Scale:
    """Transformation between an inner parameter and a number of order one."""

    parameter: Parameter
    start: float

    @property
    def by_ratio(self) -> bool:
        """Whether the parameter is searched on a logarithmic scale."""
        return self.parameter.log and self.start > 0.0

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds on the search scale."""
        return self.number(self.parameter.lower), self.number(self.parameter.upper)

    def number(self, value: float) -> float:
        """Map a value of the inner parameter to the search scale.

        Args:
            value: value in the parameter's unit; on a logarithmic scale, 1e-300 replaces smaller values.

        Returns:
            log(value / start) on a logarithmic scale, else (value - start) / unit; 0 at the start in both
            cases.
        """
        if self.by_ratio:
            return float(np.log(max(value, 1e-300) / self.start))
        return (value - self.start) / self._unit

    def value(self, number: float) -> float:
        """Map a point of the search scale to a value of the inner parameter, the inverse of `number`.

        Args:
            number: point of the search scale; 0 is the start.
        """
        return float(self.start * np.exp(number)) if self.by_ratio else self.start + number * self._unit

    @property
    def _unit(self) -> float:
        low, high = self.parameter.typical
        return abs(self.start) or high - low


def optimize_inner(
    problem: FitProblem, solution: Solution, tolerance: float = _SSE_TOLERANCE, step: float = _STEP
) -> Solution:
    """Optimize all inner parameters of a solution jointly; gains follow by variable projection.

    If the error falls considerably, the search is repeated from the new parameters, since the gains may not
    have converged. The error often depends on the square of a gain, as that of a damping whose phase a delay
    can replace. It then has a saddle where the gain is zero, on which a search can end; if a gain ends at its
    bound or within its standard error of it, points around the result are tried too. An inner parameter that
    began at its bound was held there; values inside are tried once the others are optimal.

    Args:
        problem: data, noise weights and folds of the fit.
        solution: start of the search.
        tolerance: relative decrease of the squared error below which the search ends.
        step: step of the difference quotient, relative to a parameter's scale.
    """
    for _ in range(_MAX_REPEATS):
        before, solution = solution, _optimize_once(problem, solution, tolerance, step)
        if solution.sse > _REPEAT_RATIO * before.sse:
            break
    lower = next((near for near in _nearby_solutions(problem, solution) if near.sse < solution.sse), None)
    if lower is not None:
        released = _optimize_once(problem, lower, tolerance, step)
        keeps_bounds = _at_bounds(solution) <= _at_bounds(released)
        if keeps_bounds or released.sse < (1.0 - _RELEVANT) * solution.sse:
            solution = released
    return replace(solution, parameters=solution.model.in_order(solution.parameters))


def _at_bounds(solution: Solution) -> set[str]:
    """Return the names of the inner parameters at a bound."""
    values, inner = solution.parameters, solution.model.inner
    return {name for name, parameter in inner.items() if values[name] in {parameter.lower, parameter.upper}}


def _nearby_solutions(problem: FitProblem, solution: Solution) -> Iterator[Solution]:
    """Yield solutions with one inner parameter changed: one at its bound, or any if a gain is near one."""
    model, values = solution.model, solution.parameters
    errors = solution.standard_errors
    distances = {n: min(abs(values[n] - end) for end in ends) for n, ends in model.gain_bounds.items()}
    any_inner = any(distance <= errors[name] for name, distance in distances.items())
    at_bounds = _at_bounds(solution)
    for name, inner in model.inner.items():
        if name in model.held or not (any_inner or name in at_bounds):
            continue
        size = abs(values[name]) or inner.typical[1] - inner.typical[0]
        for share in (-_RELEASE, _RELEASE, *_CHANGES) if name in at_bounds else _CHANGES:
            value = float(np.clip(values[name] + share * size, inner.lower, inner.upper))
            changed = {**values, name: value}
            yield solve_gains(problem, model, changed, max_ratio=_CONVERGED_RATIO)


def _optimize_once(problem: FitProblem, solution: Solution, tolerance: float, step: float) -> Solution:
    """Optimize once; parameters at a bound are held there, since they would shorten the others' steps."""
    scales = {
        name: _Scale(parameter, solution.parameters[name])
        for name, parameter in solution.model.inner.items()
        if name not in solution.model.held and parameter.lower < solution.parameters[name] < parameter.upper
    }
    if not scales:
        return solve_gains(problem, solution.model, solution.parameters, rounds=3)

    def values(numbers: FloatArray) -> dict[str, float]:
        return {name: scale.value(x) for (name, scale), x in zip(scales.items(), numbers, strict=True)}

    last = [(b"", solution)]

    def solve_at(numbers: FloatArray) -> Solution:
        if last[0][0] != numbers.tobytes():
            changed = {**solution.parameters, **values(numbers)}
            solved = solve_gains(problem, solution.model, changed, max_ratio=_CONVERGED_RATIO)
            last[:] = [(numbers.tobytes(), solved)]
        return last[0][1]

    unit = float(np.sqrt(np.mean(problem.whiten(solution.target) ** 2))) or 1.0  # for a relative tolerance
    low, high = (np.array(side) for side in zip(*(s.bounds for s in scales.values()), strict=True))

    def residual(numbers: FloatArray) -> FloatArray:
        return problem.whiten(solve_at(numbers).residual) / unit

    def jacobian(numbers: FloatArray) -> FloatArray:
        steps = np.where(numbers + step <= high, step, -step)
        return residual_slopes(problem, solve_at(numbers), values(numbers + steps)) / (unit * steps)

    optimum = scipy.optimize.least_squares(
        residual,
        np.zeros(len(scales)),
        jac=jacobian,
        bounds=(low, high),
        ftol=tolerance,
        xtol=_STEP_TOLERANCE,
        max_nfev=_EVALUATIONS,
        x_scale=0.1,
    )
    optimized = solve_at(optimum.x)
    return optimized if optimized.sse < solution.sse else solution
