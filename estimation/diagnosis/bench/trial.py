"""One model tried at given inner parameters, and the search over them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from estimation.channel import ChannelKind
from estimation.diagnosis.bench.along import Along, is_on_blocks, parts_along
from estimation.diagnosis.bench.colour import Colour
from estimation.diagnosis.bench.frame import Frame
from estimation.diagnosis.bench.moments import Moments, Scores, cross_products, score
from estimation.effect import Effect, Parameter
from estimation.model import Model, Parts, own
from robot_io.types import BoolArray, FloatArray, IntArray

_HALVINGS = 3
_PARABOLAS = 3
_MOST_ROUNDS = 7


@dataclass(frozen=True)
class Bench:
    """Where models are tried: the blocks and the colour of their noise."""

    frame: Frame
    colour: Colour

    @cached_property
    def kept(self) -> BoolArray:
        """Blocks that count, shape (m,)."""
        return self.colour.kept(self.frame.run, self.frame.trusted)

    @cached_property
    def _by_fold(self) -> tuple[IntArray, list[slice]]:
        """Blocks that count, in the order of the folds that hold them out, and where in it each fold is."""
        fold = np.where(self.kept, self.frame.fold, -1)
        order = np.argsort(fold, kind="stable")[np.sum(~self.kept) :]
        borders = np.searchsorted(fold[order], np.arange(self.frame.folds + 1)).tolist()
        return order, [slice(*ends) for ends in pairwise(borders)]

    def whiten(self, blocks: FloatArray) -> FloatArray:
        """Blocks (m,) or (m, k) with the colour taken out, shape (w,) or (w, k)."""
        return self.colour.whiten(blocks)[self.kept]

    def fit(self, columns: FloatArray, target: FloatArray) -> Scores:
        """Linear fit of blocks (m, q) to a target (m,)."""
        return score(self.moments(columns, target), dof=len(self._by_fold[0]))

    def moments(self, columns: FloatArray, target: FloatArray) -> Moments:
        """Cross products of blocks (m, q) and a target (m,) with the colour taken out, by fold."""
        order, folds = self._by_fold
        white = np.take(self.colour.whiten(np.column_stack([columns, target])), order, axis=0)
        return cross_products(white[rows] for rows in folds)


@dataclass(frozen=True)
class Trial:
    """A model with parameters, and how well it fits.

    Attributes:
        model: what was tried.
        parameters: gains and inner parameters by "effect.parameter".
        columns: slopes by each gain on blocks, shape (m, q), not whitened.
        target: effort on blocks that the columns explain, shape (m,), not whitened.
        scores: of the linear fit at these inner parameters.
    """

    model: Model
    parameters: dict[str, float]
    columns: FloatArray
    target: FloatArray
    scores: Scores

    @property
    def spread(self) -> dict[str, float]:
        """Standard errors of the gains for white noise, by "effect.parameter"."""
        return dict(zip(self.model.gains, self.scores.spread.tolist(), strict=True))

    @property
    def sse(self) -> float:
        """Sum of squared whitened residuals."""
        return float(self.scores.sse.sum())

    @property
    def residual(self) -> FloatArray:
        """Effort less prediction on blocks, shape (m,)."""
        gains = np.array([self.parameters[name] for name in self.model.gains])
        left: FloatArray = self.target - self.columns @ gains
        return left

    @property
    def held_out(self) -> float:
        """Sum of squared whitened residuals in held-out runs."""
        return float(self.scores.held_out.sum())


def attempt(
    bench: Bench,
    model: Model,
    parameters: Mapping[str, float],
    rounds: int | None = None,
    arrived: float = 1.02,
    *,
    parts: Parts | None = None,
) -> Trial:
    """Fit the gains at the inner parameters given, from the gains given (zero where there is none).

    Args:
        bench: where to try.
        model: what to try.
        parameters: inner parameters and known gains.
        rounds: Gauss-Newton steps at least; by default one, or two where the model is bent by its own effort.
            Where a sensor bends it, more are made until one leads where the last was expected to.
        arrived: times the energy that a step promised to leave, that is taken as kept.
        parts: from `Model.parts` at these inner parameters, where they are at hand.
    """
    data = bench.frame.data
    if is_on_blocks(data, model):
        return _sum(bench, model, parameters)
    bent = not model.is_linear_in_gains or data.kind is ChannelKind.CONTACT
    now = {name: parameters.get(name, 0.0) for name in (*model.gains, *model.inner)}
    names = list(model.gains)
    least = rounds or (2 if bent else 1)
    most = least if model.is_linear_in_gains else max(_MOST_ROUNDS, least)
    expected, before = np.inf, np.empty(0)
    parts = parts or model.parts(data, now)
    for number in range(most):
        slopes, effort = model.linearise(data, now, parts)
        if model.is_linear_in_gains and np.array_equal(slopes, before):
            break  # where the object lets go is where it did: the same fit again
        before = slopes
        gains = np.array([now[name] for name in names])
        target = bench.frame.reduce(data.effort - effort + slopes @ gains)
        columns = bench.frame.reduce(slopes)
        if number >= least and _energy(bench, target - columns @ gains) <= arrived * expected:
            break
        scores = bench.fit(columns, target)
        expected = float(scores.sse.sum())
        now.update(zip(names, scores.gains.tolist(), strict=True))
    return Trial(model, now, columns, target, scores)


def _sum(bench: Bench, model: Model, parameters: Mapping[str, float]) -> Trial:
    """The same for a sum of effects that no sensor bends: all that is needed is on blocks."""
    frame, blocks, target = bench.frame, [np.empty((len(bench.frame), 0))], bench.frame.effort
    inner = {name: parameters.get(name, 0.0) for name in model.inner}
    for effect in model.additive:
        blocks.append(frame.columns(effect, own(effect, inner)))
        target = target - frame.known(effect, own(effect, inner))
    columns = np.hstack(blocks)
    scores = bench.fit(columns, target)
    gains = dict(zip(model.gains, scores.gains.tolist(), strict=True))
    return Trial(model, {**gains, **inner}, columns, target, scores)


def _energy(bench: Bench, blocks: FloatArray) -> float:
    left = bench.whiten(blocks)
    return float(left @ left)


@dataclass(frozen=True)
class Search:
    """All trials of one candidate.

    Attributes:
        trials: at all inner parameters that were tried; the first are those at the starts.
        start_count: how many of them.
    """

    trials: tuple[Trial, ...]
    start_count: int

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


def look(
    bench: Bench,
    model: Model,
    effect: Effect,
    parameters: Mapping[str, float],
    starts: Iterable[Mapping[str, float]],
) -> Search:
    """Try `effect`, which is part of `model`, at its starts."""
    along = parts_along(bench.frame.data, model, effect, parameters)
    trials = tuple(_at(bench, model, effect, parameters, inner, along=along) for inner in starts)
    return Search(trials, len(trials))


def refine(bench: Bench, model: Model, effect: Effect, looked: Search) -> Search:
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
    return Search(tuple(trials), looked.start_count)


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
    if not (left > 0.0 and right > 0.0):
        return []
    bend = (low - here) / left + (high - here) / right
    if not bend > 0.0:
        return []
    lowest = along[1] + 0.5 * ((low - here) / left * right - (high - here) / right * left) / bend
    value = float(np.exp(lowest) if inner.log and values[0] > 0.0 else lowest)
    return [{**grid[best], inner.name: value}] if values[0] < value < values[2] else []


def _outside(line: list[float], inner: Parameter, *, upwards: bool) -> float:
    """Where the grid ends: twice as far outside as its last step was wide, within the bounds."""
    if len(line) < 2:
        return inner.upper if upwards else inner.lower
    end, before = (line[-1], line[-2]) if upwards else (line[0], line[1])
    beyond = end * (end / before) ** 2 if inner.log and before > 0.0 else end + 2.0 * (end - before)
    return float(np.clip(beyond, inner.lower, inner.upper))
