"""One model tried at given inner parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from estimation.channel import ChannelKind
from estimation.fit.along import is_on_blocks
from estimation.fit.colour import WHITE, Colour
from estimation.fit.frame import Frame
from estimation.fit.moments import Moments, Scores, cross_products, score
from estimation.information import Information
from estimation.model import Model, Parts, own
from robot_io.types import BoolArray, FloatArray, IntArray

NOT_HELD: Mapping[str, float] = MappingProxyType({})
_MOST_ROUNDS = 7
_LOST = 1e6  # times the largest effort


@dataclass(frozen=True)
class Bench:
    """Where models are tried: the blocks, the colour of their noise, and weights of their residuals (m,)."""

    frame: Frame
    colour: Colour
    weights: FloatArray | None = None

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
        return self._white(blocks)[self.kept]

    def _white(self, blocks: FloatArray) -> FloatArray:
        white = self.colour.whiten(blocks)
        return white if self.weights is None else (white.T * self.weights).T

    def fit(
        self,
        columns: FloatArray,
        target: FloatArray,
        names: Sequence[str] = (),
        held: Mapping[str, float] = NOT_HELD,
    ) -> Scores:
        """Linear fit of blocks (m, q) to a target (m,), with the gains of some names held; see `moments`."""
        free = [i for i, name in enumerate(names) if name not in held] if held else []
        if not held or len(free) == len(names):
            return score(self.moments(columns, target, names), dof=len(self._by_fold[0]))
        gains = np.array([held.get(name, 0.0) for name in names])
        left = self.moments(columns[:, free], target - columns @ gains, [names[i] for i in free])
        return score(left, dof=len(self._by_fold[0])).beside(gains, free)

    def moments(self, columns: FloatArray, target: FloatArray, names: Sequence[str] = ()) -> Moments:
        """Cross products of blocks (m, q) and a target (m,) with the colour taken out, by fold.

        Args:
            columns: shape (m, q).
            target: shape (m,).
            names: of the gains of the first columns, by which others of the arm may know them.
        """
        order, folds = self._by_fold
        white = self._white(np.concatenate([columns.T, target[None]]).T).T.take(order, axis=1)
        return Moments(
            cross_products(white[:, rows].T for rows in folds).products, self._known(names, columns.shape[1])
        )

    def _known(self, names: Sequence[str], count: int) -> Information | None:
        """What other channels say of so many gains, of which the first have names; None if nothing."""
        shared = self.frame.data.shared
        if shared is None or self.colour is not WHITE or not set(shared.names) <= set(names):
            return None
        place = [list(names).index(name) for name in shared.names]
        size = len(shared.information.matrix)
        matrix, vector = np.zeros((size, count, count)), np.zeros((size, count))
        matrix[:, np.array(place)[:, None], place] = shared.information.matrix
        vector[:, place] = shared.information.vector
        return Information(matrix, vector)


@dataclass(frozen=True)
class Trial:
    """A model with parameters, and how well it fits."""

    model: Model  # what was tried
    parameters: dict[str, float]  # gains and inner parameters by "effect.parameter"
    columns: FloatArray  # slopes by each gain on blocks, shape (m, q), not whitened
    target: FloatArray  # effort on blocks that the columns explain, shape (m,), not whitened
    scores: Scores  # of the linear fit at these inner parameters

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

    @property
    def is_physical(self) -> bool:
        """Whether no gain is beyond its bounds by more than twice its standard error."""
        gains, spread = self.model.gains, self.spread
        slack = {name: 2.0 * spread[name] for name in gains}
        return all(
            p.lower - slack[name] <= self.parameters[name] <= p.upper + slack[name]
            for name, p in gains.items()
        )

    def without_blocks(self) -> "Trial":
        """The same with no columns and no target: enough to be compared, and of long data far smaller."""
        return replace(self, columns=self.columns[:0].copy(), target=self.target[:0].copy())


def held_out_residual(frame: Frame, trial: Trial) -> FloatArray:
    """Effort less what the gains fitted to the other folds predict, shape (n,); NaN outside blocks."""
    slopes, effort = trial.model.linearise(frame.data, trial.parameters)
    gains = np.array([trial.parameters[name] for name in trial.model.gains])
    residual = np.full(len(frame.data), np.nan)
    for fold, fitted in enumerate(trial.scores.fold_gains):
        rows = frame.rows[(frame.fold == fold) & frame.trusted].ravel()
        residual[rows] = frame.data.effort[rows] - effort[rows] - slopes[rows] @ (fitted - gains)
    return residual


def rmse(residual: FloatArray) -> float:
    """Root mean square over the samples that have a value."""
    return float(np.sqrt(np.nanmean(residual**2)))


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
    expected, before = np.inf, np.empty(0, dtype=np.int64)
    parts = parts or model.parts(data, now)
    for number in range(most):
        lifted = model.lifted(data, now, parts)
        if number and model.is_linear_in_gains and np.array_equal(lifted, before):
            break  # where the object lets go is where it did: the same fit again
        before = lifted
        slopes, effort = model.linearise(data, now, parts, lifted)
        by_gain, gains = bench.frame.reduce(slopes), np.array([now[name] for name in names])
        wanted = bench.frame.reduce(data.effort - effort) + by_gain @ gains
        if number and not np.abs(wanted).max() < _LOST * np.abs(data.effort).max():
            break  # the last step led nowhere near the data, and the next would overflow
        target, columns = wanted, by_gain
        if number >= least and _energy(bench, target - columns @ gains) <= arrived * expected:
            break
        scores = bench.fit(columns, target, names, model.held)
        expected = float(scores.sse.sum())
        now.update(zip(names, scores.gains.tolist(), strict=True))
    return Trial(model, now, columns, target, scores)


def _sum(bench: Bench, model: Model, parameters: Mapping[str, float]) -> Trial:
    """The same for a sum of effects that a sensor scales at most: all that is needed is on blocks."""
    frame, blocks, known = bench.frame, [np.empty((0, len(bench.frame)))], np.zeros(len(bench.frame))
    inner = {name: parameters.get(name, 0.0) for name in model.inner}
    for effect in model.additive:
        blocks.append(frame.columns(effect, own(effect, inner)).T)
        known = known + frame.known(effect, own(effect, inner))
    columns = np.concatenate(blocks).T
    for sensor in model.sensors:
        sensed = sensor.sense(np.column_stack([columns, known]), frame.data, own(sensor, inner))
        columns, known = sensed[:, :-1], sensed[:, -1]
    target = frame.effort - known
    scores = bench.fit(columns, target, list(model.gains), model.held)
    gains = dict(zip(model.gains, scores.gains.tolist(), strict=True))
    return Trial(model, {**gains, **inner}, columns, target, scores)


def _energy(bench: Bench, blocks: FloatArray) -> float:
    left = bench.whiten(blocks)
    return float(left @ left)
