"""One way to doubt: would the data look like this if the model were right?

Draw measurements from the fitted model through the whole reading chain, put each through the routine that
judged the data, and see where the data stand among the draws (A. C. Davison, D. V. Hinkley, Bootstrap Methods
and their Application (1997), ch. 4; D. R. Cox, JRSS B 24 (1962) for two models). Drawing stops as soon as the
answer is clear (J. Besag, P. Clifford, Sequential Monte Carlo p-values, Biometrika 78 (1991)).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel import ChannelData
from estimation.fit.chance import surrogates
from estimation.fit.flexible import flexible
from estimation.fit.held_out import held_out_blocks
from estimation.fit.inner_search import look
from estimation.fit.memory import Memory
from estimation.fit.readings import Readings, shuffled
from estimation.fit.standing import Fit, Standing
from estimation.fit.trial import Bench, Trial, attempt
from robot_io.types import FloatArray

DRAWS = 19  # at most: of 20 data sets, one is the largest by chance once in twenty
_USUAL = 2  # draws as large as the data, after which these are nothing unusual
_FEW, _FAR = 4, 3.0  # draws, and times the largest of them: data beyond need no more draws
_STARTS = 6  # of an effect's inner parameters, that are tried on a draw beside those found
_LEAST_NOISE = 0.05  # share of the noise that is the effort's own, however much the readings may make
_RIVAL_LEVEL = 0.01  # of refusing a rival that is right
_ROUNDING = 0.02  # of the squared error: models closer than this are equally good


@dataclass(frozen=True)
class Placed:
    """Where a figure of the data stands among those of draws, shape (d,)."""

    observed: float
    drawn: FloatArray

    @property
    def is_unusual(self) -> bool:
        """Whether the data are beyond all draws."""
        return bool(self.observed > np.max(self.drawn, initial=0.0))


def place(observed: float, draws: Iterator[float]) -> Placed:
    """Compare a figure with draws of it, as many as are needed."""
    drawn: list[float] = []
    for figure in draws:
        drawn.append(figure)
        as_large = sum(one >= observed for one in drawn)
        clear = len(drawn) >= _FEW and as_large == 0 and observed > _FAR * max(*drawn, 0.0)
        if as_large >= _USUAL or len(drawn) >= DRAWS or clear:
            break
    return Placed(observed, np.array(drawn))


def still_explained(standing: Standing, readings: Readings, rng: np.random.Generator) -> Placed:
    """Share of the held-out error that a smooth law explains beside a model, in the data and in draws from it."""
    return place(standing.left_of_blocks(), (_share(*one) for one in draws(standing, readings, rng)))


def still_gained(
    before: Standing, after: Standing, name: str, readings: Readings, rng: np.random.Generator
) -> Placed:
    """Share of the held-out error that an effect takes away, in the data and in draws from the model without it.

    Args:
        before: the model without the effect.
        after: the model with it; what it leaves is the noise of the draws.
        name: of the effect.
        readings: how the motion was read.
        rng: for the draws.
    """
    model = after.trial.model
    effect = next(one for one in model.effects if one.name == name)
    found = {one.name: after.trial.parameters[f"{name}.{one.name}"] for one in effect.inner}
    starts = effect.starts(before.data)
    tried = [found, *starts[:: max(len(starts) // _STARTS, 1)]]

    def gain(bench: Bench, trial: Trial) -> float:
        looked = look(bench, model, effect, {**after.trial.parameters, **trial.parameters}, tried)
        return 1.0 - float(np.sqrt(looked.held_out.sum() / max(trial.held_out, 1e-300)))

    observed = 1.0 - float(np.sqrt(after.trial.held_out / before.trial.held_out))
    return place(observed, (gain(*one) for one in draws(before, readings, rng, after.flexible.residual)))


def draws(
    standing: Standing, readings: Readings, rng: np.random.Generator, left: FloatArray | None = None
) -> Iterator[tuple[Bench, Trial]]:
    """A model fitted to measurements drawn from itself, without end.

    Args:
        standing: the model.
        readings: how the motion was read.
        rng: for the draws.
        left: noise on blocks, shape (m,); by default what a smooth law leaves of the model's error.
    """
    frame, model, known = standing.plain.frame, standing.trial.model, standing.trial.parameters
    expected = model.predict(_with_derived(readings.true_motion(rng), standing.data), known)
    left = standing.flexible.residual if left is None else left
    noise = _own_noise(standing, readings, expected, left, rng)
    while True:
        effort = expected.copy()
        effort[frame.rows] += shuffled(noise, frame.run, rng)[:, None]
        data = replace(_with_derived(readings.draw(rng), standing.data), effort=effort)
        bench = Bench(replace(frame, data=data, memory=Memory(), of_load=Memory()), standing.plain.colour)
        yield bench, attempt(bench, model, known, rounds=2)


def _own_noise(
    standing: Standing, readings: Readings, expected: FloatArray, left: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """The effort's noise on blocks, (m,): what is left, less what another reading of the motion makes of it."""
    frame = standing.plain.frame
    read = _with_derived(readings.draw(rng), standing.data)
    apart = frame.reduce(standing.trial.model.predict(read, standing.trial.parameters) - expected)
    share = 1.0 - float(np.var(apart[frame.trusted])) / max(float(np.var(left[frame.trusted])), 1e-300)
    scaled: FloatArray = np.sqrt(max(share, _LEAST_NOISE)) * left
    return scaled


def _with_derived(moved: ChannelData, fitted: ChannelData) -> ChannelData:
    """A channel with the signals that the fit derived (the load) beside its motion."""
    return replace(moved, context={**fitted.context, **moved.context})


def _share(bench: Bench, trial: Trial) -> float:
    after = float(flexible(bench, trial).held_out.sum())
    return float(1.0 - np.sqrt(after / trial.held_out)) if trial.held_out > 0.0 else 0.0


def is_as_good(ours: Standing, theirs: Fit, rng: np.random.Generator) -> bool:
    """Whether the data do not refuse another model beside one that fits at least as well.

    If theirs were right, our error would be smaller by chance alone: with d the difference of the two
    predictions and noise n, by 2 n d - d d. Theirs is refused if the data's difference is beyond what draws
    of the noise make of it.

    Args:
        ours: a model.
        theirs: another, of the same base model.
        rng: for the draws.
    """
    kept = ours.plain.kept & theirs.plain.kept  # where a contact begins may differ
    left = held_out_blocks(ours.plain.frame, ours.trial)[kept]
    apart = held_out_blocks(theirs.plain.frame, theirs.trial)[kept] - left
    observed = float(np.sum((left + apart) ** 2) - np.sum(left**2))
    if observed <= _ROUNDING * float(left @ left):
        return True
    drawn = surrogates(ours.flexible.residual[kept], ours.plain.frame.run[kept], rng)
    chance = 2.0 * (apart @ drawn) - float(apart @ apart)
    return observed <= float(np.quantile(chance, 1.0 - _RIVAL_LEVEL))
