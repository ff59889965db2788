"""One way to doubt: would the data look like this if the model were right?

Draw measurements from the fitted model through the whole reading chain, put each through the routine that
judged the data, and see where the data stand among the draws (A. C. Davison, D. V. Hinkley, Bootstrap Methods
and their Application (1997), ch. 4; D. R. Cox, JRSS B 24 (1962) for two models). Drawing stops as soon as the
answer is clear (J. Besag, P. Clifford, Sequential Monte Carlo p-values, Biometrika 78 (1991)).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from estimation.channel import ChannelData
from estimation.data.derivatives import grid_step
from estimation.effect import Effect
from estimation.fit.flexible import flexible
from estimation.fit.inner_search import look
from estimation.fit.memory import Memory
from estimation.fit.polish import polish
from estimation.fit.readings import Readings, shuffled
from estimation.fit.standing import Standing
from estimation.fit.trial import Bench, Trial, attempt
from estimation.model import Model
from estimation.signals.moved import moved
from robot_io.types import BoolArray, FloatArray

SMALL = 0.05  # of an error: a smaller change is told, and changes no verdict
DRAWS = 19  # at most: of 20 data sets, one is the largest by chance once in twenty
_FEW = 4  # draws, at least
_CHANCE = 1e-3  # that one more draw would be as large as the data, if draws are normal: then they are enough
_FAR = 3.0  # times the largest of draws, beyond which no polish takes them
_SETTLED = 1e-3  # share of a draw's energy that a step of its fit must take away; `SMALL` decides
_STARTS = 6  # of an effect's inner parameters, that are tried on a draw beside those found
_LEAST_NOISE = 0.05  # share of the noise that is the effort's own, however much the readings may make


@dataclass(frozen=True)
class Placed:
    """Where a figure of the data stands among those of draws, shape (d,)."""

    observed: float
    drawn: FloatArray

    @property
    def is_unusual(self) -> bool:
        """Whether the data are beyond all draws, and by more than a small share of the error."""
        return bool(self.observed > np.max(self.drawn, initial=0.0) + SMALL)

    @property
    def is_clear(self) -> bool:
        """Whether the data are so far beyond some draws that more of them would say the same.

        Beyond the range, that is, in which one more normal draw would be expected (Student's).
        """
        count = len(self.drawn)
        if count < _FEW:
            return False
        spread = float(np.std(self.drawn, ddof=1)) * np.sqrt(1.0 + 1.0 / count)
        far = stdtrit(count - 1, 1.0 - _CHANCE) * spread
        return self.is_unusual and bool(self.observed > np.mean(self.drawn) + far)


def place(observed: float, draws: Iterator[float]) -> Placed:
    """Compare a figure with draws of it, as many as are needed: none once it is nothing unusual."""
    placed = Placed(observed, np.empty(0))
    while placed.is_unusual and not placed.is_clear and len(placed.drawn) < DRAWS:
        placed = Placed(observed, np.append(placed.drawn, next(draws)))
    return placed


def still_explained(standing: Standing, readings: Readings, rng: np.random.Generator) -> Placed:
    """Share of the held-out error that a smooth law explains beside a model, in data and in draws from it.

    What it explains in draws that leave less than the data counts beside what the data leave.
    """
    drawn = (
        flexible(bench, trial, standing.windows).share_of(trial, standing.trial.held_out)
        for bench, trial in draws(standing, readings, rng)
    )
    return place(standing.left_of_blocks(), drawn)


def of_steps(standing: Standing, readings: Readings) -> float:
    """Error of a model, root mean square on blocks, if an arm's tip were read half a step off; 0 if no steps.

    The tip moves by steps of several encoders. One that hardly turns is off by up to half a step, and in the
    same way in each pass: no draw knows that error, and a smooth law of the position describes it (B. Widrow,
    I. Kollar, Quantization Noise (2008)). The size of a step is that of the errors that show.
    """
    if not readings.is_staircase:
        return 0.0
    data, kept, still = standing.data, standing.plain.kept, np.zeros(len(standing.data))
    half = np.full(len(data), float(np.sqrt(3.0 * np.mean(readings.error**2))))
    expected = (
        standing.trial.model.predict(one, standing.trial.parameters)
        for one in (moved(data, half, still, still), data)
    )
    off = standing.plain.frame.reduce(np.subtract(*expected))[kept]
    return float(np.sqrt(np.mean(off**2)))


def gained(
    before: Standing, after: Standing, readings: Readings, rng: np.random.Generator, effect: str = ""
) -> Placed:
    """Share of the held-out error by which a model beats another, in data and in draws from the other.

    It says whether an effect is needed, the model without it being `before`, and whether one model is better
    than a rival, the rival being `before` (D. R. Cox, JRSS B 24 (1962)).

    Args:
        before: the model that draws are made from.
        after: the other.
        readings: how the motion was read.
        rng: for the draws.
        effect: name of the one effect that `after` has beyond `before`, whose inner parameters are then
            looked for in each draw.
    """
    model, known = after.trial.model, after.trial.parameters
    observed = 1.0 - float(np.sqrt(after.trial.held_out / max(before.trial.held_out, 1e-300)))

    def fitted(bench: Bench, trial: Trial) -> tuple[Trial, float]:
        parameters = {**known, **{n: v for n, v in trial.parameters.items() if n in model.gains}}
        if not effect:
            made = attempt(bench, model, parameters, rounds=2)
            return made, made.held_out
        added = next(one for one in model.effects if one.name == effect)
        starts = added.starts(before.data)
        found = {one.name: known[f"{effect}.{one.name}"] for one in added.inner}
        tried = [found, *starts[:: max(len(starts) // _STARTS, 1)]]
        looked = min(
            (look(bench, one, form, parameters, tried) for one, form in _forms(model, added)),
            key=lambda one: one.best.sse,
        )
        return looked.best, float(looked.held_out.sum())

    def gain(bench: Bench, trial: Trial) -> float:
        left = fitted(bench, trial)[1]
        return 1.0 - float(np.sqrt(left / max(trial.held_out, 1e-300)))

    def polished_gain(bench: Bench, trial: Trial) -> float:
        left, had = (polish(bench, one, _SETTLED).held_out for one in (fitted(bench, trial)[0], trial))
        return 1.0 - float(np.sqrt(left / max(had, 1e-300)))

    def placed(of_one: Callable[[Bench, Trial], float]) -> Placed:
        drawn = draws(before, readings, rng)
        return place(observed, (of_one(*one) for one in drawn))

    roughly = placed(gain)
    if not roughly.is_unusual or observed > _FAR * np.max(roughly.drawn, initial=0.0):
        return roughly
    return placed(polished_gain)  # all inner parameters were fitted to the data, too


def draws(
    standing: Standing,
    readings: Readings,
    rng: np.random.Generator,
    own: FloatArray | None = None,
) -> Iterator[tuple[Bench, Trial]]:
    """A model fitted to measurements drawn from itself, without end.

    Args:
        standing: the model.
        readings: how the motion was read.
        rng: for the draws.
        own: the effort's own noise on blocks, shape (m,), where it is known; else what a smooth law leaves of
            the model's error, less what reading the motion makes of it.
    """
    frame, model, known = standing.plain.frame, standing.trial.model, standing.trial.parameters
    expected = model.predict(_with_derived(readings.true_motion, standing.data), known)
    noise = _own_noise(standing, readings, expected, rng) if own is None else own
    noise = _of_trusted(noise, frame.trusted)
    step = 0.0 if own is None else grid_step(np.sort(standing.data.effort))  # else the noise has steps
    while True:
        effort = expected.copy()
        effort[frame.rows] += shuffled(noise, frame.run, rng)[:, None]
        effort = np.round(effort / step) * step if step > 0.0 else effort
        data = replace(_with_derived(readings.draw(rng), standing.data), effort=effort)
        bench = Bench(replace(frame, data=data, memory=Memory(), of_load=Memory()), standing.plain.colour)
        yield bench, attempt(bench, model, known, rounds=2)


def _forms(model: Model, effect: Effect) -> list[tuple[Model, Effect]]:
    """A model with one of its effects in each of its forms, and that."""
    forms = effect.forms()
    if len(forms) == 1:
        return [(model, effect)]
    without = model.without(effect.name)
    return [(without.with_effect(form), form) for form in forms]


def _own_noise(
    standing: Standing, readings: Readings, expected: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """The effort's noise on blocks, (m,): what is left, less what reading the motion again makes of it."""
    frame, left = standing.plain.frame, standing.flexible.residual
    read = _with_derived(readings.draw(rng), standing.data)
    apart = frame.reduce(standing.trial.model.predict(read, standing.trial.parameters) - expected)
    share = 1.0 - float(np.var(apart[frame.trusted])) / max(float(np.var(left[frame.trusted])), 1e-300)
    scaled: FloatArray = np.sqrt(max(share, _LEAST_NOISE)) * left
    return scaled


def _of_trusted(noise: FloatArray, trusted: BoolArray) -> FloatArray:
    """Noise on blocks (m,), that of others in the place of those in which the error is more than noise."""
    filled = noise.copy()
    filled[~trusted] = np.resize(noise[trusted], int(np.sum(~trusted)))
    return filled


def _with_derived(moved: ChannelData, fitted: ChannelData) -> ChannelData:
    """A channel with the signals that the fit derived (the load) beside its motion."""
    return replace(moved, context={**fitted.context, **moved.context})
