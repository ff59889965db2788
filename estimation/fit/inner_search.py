"""The search for the inner parameters of one effect, the others of its model as they are."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.effect import Effect, Parameter
from estimation.fit.fit_problem import FitProblem, Solution, solve_gains
from estimation.fit.linearised_parts import LinearisedParts, linearise_along
from estimation.model import Model
from robot_io.types import FloatArray

_HALVINGS = 3
_PARABOLAS = 3


@dataclass(frozen=True)
class GridSearch:
    """All trials of one candidate."""

    # At all inner parameters that were tried; the first are those at the starts. Only the best has its
    # blocks: those of all would fill the memory.
    solutions: tuple[Solution, ...]
    start_count: int  # how many of them

    @property
    def starts(self) -> tuple[Solution, ...]:
        """The trials at the starts."""
        return self.solutions[: self.start_count]

    @property
    def best(self) -> Solution:
        """The trial that fits all data best."""
        return min(self.solutions, key=lambda solution: solution.sse)

    @property
    def held_out(self) -> FloatArray:
        """Squared whitened residuals of each fold, the inner parameters chosen on the other folds."""
        train = np.array([solution.linear_fit.train for solution in self.solutions])
        held_out = np.array([solution.linear_fit.held_out for solution in self.solutions])
        chosen: FloatArray = held_out[np.argmin(train, axis=0), np.arange(train.shape[1])]
        return chosen

    def without_blocks(self) -> "GridSearch":
        """The same, the best trial without its blocks too."""
        return replace(self, solutions=tuple(solution.without_blocks() for solution in self.solutions))


def search_inner(
    problem: FitProblem,
    model: Model,
    effect: Effect,
    parameters: Mapping[str, float],
    starts: Iterable[Mapping[str, float]],
) -> GridSearch:
    """Try `effect`, which is part of `model`, at its starts."""
    along = linearise_along(problem.blocked.data, model, effect, parameters)
    places = list(starts)
    solutions = (_at(problem, model, effect, parameters, inner, along=along) for inner in places)
    return grid_search(solutions, len(places))


def grid_search(solutions: Iterable[Solution], start_count: int) -> GridSearch:
    """All trials of a candidate, of which the best keeps its blocks."""
    kept: list[Solution] = []
    best = 0
    for number, solution in enumerate(solutions):
        kept.append(solution)
        if number and solution.sse < kept[best].sse:
            kept[best], best = kept[best].without_blocks(), number
        elif number:
            kept[number] = solution.without_blocks()
    return GridSearch(tuple(kept), start_count)


def refine_inner(problem: FitProblem, model: Model, effect: Effect, looked: GridSearch) -> GridSearch:
    """Try an effect closer and closer around the best of what was tried."""
    solutions = list(looked.solutions)
    along = linearise_along(problem.blocked.data, model, effect, solutions[0].parameters)
    grid = [
        {p.name: solution.parameters[f"{effect.name}.{p.name}"] for p in effect.inner}
        for solution in solutions
    ]
    for inner in effect.inner * (1 if len(effect.inner) == 1 else 2) if len(grid) > 1 else ():
        for number in range(_HALVINGS + _PARABOLAS):
            best = min(range(len(solutions)), key=lambda i: solutions[i].sse)
            line = _line(grid, best, inner)
            closer = _between(grid, best, inner, line)
            if number >= _HALVINGS:
                closer = _vertex(grid, solutions, line, best, inner) or closer
            for point in closer:
                grid.append(point)
                solutions.append(_at(problem, model, effect, solutions[best].parameters, point, along=along))
    return grid_search(solutions, looked.start_count)


def _at(
    problem: FitProblem,
    model: Model,
    effect: Effect,
    parameters: Mapping[str, float],
    inner: Mapping[str, float],
    *,
    along: LinearisedParts,
) -> Solution:
    there = {f"{effect.name}.{name}": value for name, value in inner.items()}
    return solve_gains(problem, model, {**parameters, **there}, rounds=1, parts=along(inner))


def _line(grid: list[dict[str, float]], best: int, inner: Parameter) -> list[int]:
    """Points that differ from the best in one inner parameter only, in its order."""
    here = grid[best]
    same = [i for i, p in enumerate(grid) if all(p[n] == here[n] for n in p if n != inner.name)]
    return sorted(same, key=lambda i: grid[i][inner.name])


def _between(
    grid: list[dict[str, float]], best: int, inner: Parameter, line: list[int]
) -> list[dict[str, float]]:
    """The two points half-way to the best one's neighbours on a line, or further out where it ends."""
    here = grid[best]
    values = [grid[i][inner.name] for i in line]
    at = line.index(best)
    value = here[inner.name]
    low = values[at - 1] if at > 0 else _outside(values, inner, upwards=False)
    high = values[at + 1] if at + 1 < len(line) else _outside(values, inner, upwards=True)
    closer = []
    for other, outside in ((low, at == 0), (high, at + 1 == len(line))):
        middle = np.sqrt(value * other) if inner.log and value * other > 0.0 else 0.5 * (value + other)
        number = other if outside else middle
        closer.append({**here, inner.name: float(np.clip(number, inner.lower, inner.upper))})
    return [point for point in closer if point[inner.name] != value]


def _vertex(
    grid: list[dict[str, float]], solutions: list[Solution], line: list[int], best: int, inner: Parameter
) -> list[dict[str, float]]:
    """The lowest point of the parabola through the best point of a line and its neighbours, if any."""
    at = line.index(best)
    if not 0 < at < len(line) - 1:
        return []
    three = line[at - 1 : at + 2]
    values = np.array([grid[i][inner.name] for i in three])
    along = np.log(values) if inner.log and values[0] > 0.0 else values
    low, here, high = (solutions[i].sse for i in three)
    left, right = along[1] - along[0], along[2] - along[1]
    bend = (low - here) * right + (high - here) * left
    if not bend > 0.0:
        return []
    lowest = along[1] + 0.5 * ((low - here) * right**2 - (high - here) * left**2) / bend
    value = float(np.exp(lowest) if inner.log and values[0] > 0.0 else lowest)
    return [{**grid[best], inner.name: value}]


def _outside(line: list[float], inner: Parameter, *, upwards: bool) -> float:
    """Where the grid ends: twice as far outside as its last step was wide, within the bounds."""
    if len(line) < 2:
        return inner.upper if upwards else inner.lower
    end, before = (line[-1], line[-2]) if upwards else (line[0], line[1])
    beyond = end * (end / before) ** 2 if inner.log and before > 0.0 else end + 2.0 * (end - before)
    return float(np.clip(beyond, inner.lower, inner.upper))
