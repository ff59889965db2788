"""The search for the inner parameters of one effect, the others of its model as they are."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.effect import Effect, Parameter
from estimation.fit.along import Along, parts_along
from estimation.fit.trial import Bench, Trial, attempt
from estimation.model import Model
from robot_io.types import FloatArray

_HALVINGS = 3
_PARABOLAS = 3


@dataclass(frozen=True)
class Attempts:
    """All trials of one candidate."""

    # At all inner parameters that were tried; the first are those at the starts. Only the best has its
    # blocks: those of all would fill the memory.
    trials: tuple[Trial, ...]
    start_count: int  # how many of them

    @property
    def starts(self) -> tuple[Trial, ...]:
        """The trials at the starts."""
        return self.trials[: self.start_count]

    @property
    def best(self) -> Trial:
        """The trial that fits all data best."""
        return min(self.trials, key=lambda trial: trial.sse)

    @property
    def held_out(self) -> FloatArray:
        """Squared whitened residuals of each fold, the inner parameters chosen on the other folds."""
        train = np.array([trial.scores.train for trial in self.trials])
        held_out = np.array([trial.scores.held_out for trial in self.trials])
        chosen: FloatArray = held_out[np.argmin(train, axis=0), np.arange(train.shape[1])]
        return chosen

    def without_blocks(self) -> "Attempts":
        """The same, the best trial without its blocks too."""
        return replace(self, trials=tuple(trial.without_blocks() for trial in self.trials))


def look(
    bench: Bench,
    model: Model,
    effect: Effect,
    parameters: Mapping[str, float],
    starts: Iterable[Mapping[str, float]],
) -> Attempts:
    """Try `effect`, which is part of `model`, at its starts."""
    along = parts_along(bench.frame.data, model, effect, parameters)
    places = list(starts)
    trials = (_at(bench, model, effect, parameters, inner, along=along) for inner in places)
    return of(trials, len(places))


def of(trials: Iterable[Trial], start_count: int) -> Attempts:
    """All trials of a candidate, of which the best keeps its blocks."""
    kept: list[Trial] = []
    best = 0
    for number, trial in enumerate(trials):
        kept.append(trial)
        if number and trial.sse < kept[best].sse:
            kept[best], best = kept[best].without_blocks(), number
        elif number:
            kept[number] = trial.without_blocks()
    return Attempts(tuple(kept), start_count)


def refine(bench: Bench, model: Model, effect: Effect, looked: Attempts) -> Attempts:
    """Try an effect closer and closer around the best of what was tried."""
    trials = list(looked.trials)
    along = parts_along(bench.frame.data, model, effect, trials[0].parameters)
    grid = [{p.name: trial.parameters[f"{effect.name}.{p.name}"] for p in effect.inner} for trial in trials]
    for inner in effect.inner * (1 if len(effect.inner) == 1 else 2) if len(grid) > 1 else ():
        for number in range(_HALVINGS + _PARABOLAS):
            best = min(range(len(trials)), key=lambda i: trials[i].sse)
            line = _line(grid, best, inner)
            closer = _between(grid, best, inner, line)
            if number >= _HALVINGS:
                closer = _vertex(grid, trials, line, best, inner) or closer
            for point in closer:
                grid.append(point)
                trials.append(_at(bench, model, effect, trials[best].parameters, point, along=along))
    return of(trials, looked.start_count)


def _at(
    bench: Bench,
    model: Model,
    effect: Effect,
    parameters: Mapping[str, float],
    inner: Mapping[str, float],
    *,
    along: Along,
) -> Trial:
    there = {f"{effect.name}.{name}": value for name, value in inner.items()}
    return attempt(bench, model, {**parameters, **there}, parts=along(inner))


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
    grid: list[dict[str, float]], trials: list[Trial], line: list[int], best: int, inner: Parameter
) -> list[dict[str, float]]:
    """The lowest point of the parabola through the best point of a line and its neighbours, if any."""
    at = line.index(best)
    if not 0 < at < len(line) - 1:
        return []
    three = line[at - 1 : at + 2]
    values = np.array([grid[i][inner.name] for i in three])
    along = np.log(values) if inner.log and values[0] > 0.0 else values
    low, here, high = (trials[i].sse for i in three)
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
