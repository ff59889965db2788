"""Which effect comes next: every candidate is tried, the simplest of the best is weighed against chance."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.channel import ChannelKind
from estimation.diagnosis.bench.polish import polish
from estimation.diagnosis.bench.standing import Fit, Standing
from estimation.diagnosis.bench.trial import Bench, Search, Trial, look, refine
from estimation.diagnosis.search.surrogates import best_gains, p_value, surrogates
from estimation.effect import Effect, SensorEffect
from estimation.model import Model
from estimation.signals.runwise import sample_time
from robot_io.types import BoolArray, FloatArray

LEAST_GAIN = 0.02  # of the held-out error; less is not worth a name, whatever its significance
# Of the held-out error sample by sample, which is what a user sees; a joint's model has noise in it as well.
LEAST_SAMPLE_GAIN, LEAST_JOINT_SAMPLE_GAIN = 0.01, 0.05
SLIGHT = 0.003  # of the energy that all effects together take away, that each must account for
LEAST_JUDGED_GAIN = 0.0  # of what is new in each sample, which slow data says little about
LEAST_BROAD_GAIN = 0.005
LEAST_FOLDS = 0.6  # share of the folds in which the error must fall
FEW = 6  # blocks, about one touch in each run, that must not decide alone
LEVEL = 0.01  # of false alarms, over all candidates
TRIES = 3  # candidates weighed before giving up
MOST = 0.95  # of what the best candidate takes away; a simpler one that does as much comes first
PROMISING = 0.3  # of what the best candidate takes away at its starts; those below are not tried in between
REFINED = 5  # candidates that are tried in between in any case
FAR_END = 0.99  # of the upper bound of an inner parameter
LOOSE = 0.05  # of the effort, that a gain may be off its bounds before all parameters are fitted together
TIE = 0.02  # of the squared held-out error; candidates closer than this are told apart by simplicity only


@dataclass(frozen=True)
class Candidate:
    """An effect that was tried beside a model.

    Attributes:
        effect: what was tried.
        search: how well it did.
        possible: whether its parameters made physical sense, see `is_possible`.
    """

    effect: Effect
    search: Search
    possible: bool = True

    @property
    def held_out(self) -> float:
        """Sum of squared whitened residuals in held-out runs."""
        return float(self.search.held_out.sum())

    @property
    def size(self) -> int:
        """Number of parameters."""
        return size(self.effect)


def size(effect: Effect) -> int:
    """Number of parameters that make an effect what it is."""
    return len(effect.inner) + len(effect.essential or effect.gains)


def screen(
    standing: Fit,
    effects: Sequence[Effect],
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> list[Candidate]:
    """The effects that are possible beside the model, of all that were tried; see `try_all`."""
    return [candidate for candidate in try_all(standing, effects, progress) if candidate.possible]


def try_all(
    standing: Fit,
    effects: Sequence[Effect],
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> list[Candidate]:
    """Try each effect beside the model from where things stand; best in held-out runs first.

    All are tried at their starts, those that do well there also in between. What would be impossible beside
    the other parameters as they were may be possible once all are fitted together.
    """
    looked, places = [], _places(standing.trial)
    for number, effect in enumerate(effects):
        progress(number / len(effects), effect.name)
        starts = effect.starts(standing.data)
        tried = [
            look(standing.plain, model, effect, parameters, starts)
            for model in extended(standing.trial.model, effect)
            for parameters in places
        ]
        looked.append(min(tried, key=lambda one: one.best.sse))
    gains = np.array([standing.trial.sse - tried.best.sse for tried in looked])
    least = min(PROMISING * gains.max(initial=0.0), np.sort(gains)[-REFINED:].min(initial=np.inf))
    found = []
    for effect, first, gain in zip(effects, looked, gains, strict=True):
        best = refine(standing.plain, first.best.model, effect, first) if gain >= least else first
        possible = is_possible(effect, best.best, standing.plain, LOOSE)
        if not possible and gain >= PROMISING * gains.max():
            best = Search((*best.trials, polish(standing.plain, best.best)), best.start_count)
            possible = is_possible(effect, best.best, standing.plain, LOOSE)
        found.append(Candidate(effect, best, possible))
    return sorted(found, key=lambda candidate: candidate.held_out)


def _places(trial: Trial) -> list[dict[str, float]]:
    """Where effects are tried: as things stand, and as if an offset (what may be nothing) were none."""
    nothing = {name: 0.0 for name, inner in trial.model.inner.items() if inner.lower < 0.0 < inner.upper}
    return [trial.parameters, *([{**trial.parameters, **nothing}] if nothing else [])]


def extended(model: Model, effect: Effect) -> list[Model]:
    """The model with one more effect; what a sensor does may come before or after what it already does."""
    if isinstance(effect, SensorEffect) and any(isinstance(e, SensorEffect) for e in model.effects):
        return [model.with_effect(effect), model.with_effect_first(effect)]
    return [model.with_effect(effect)]


def choose(standing: Standing, found: Sequence[Candidate]) -> list[Candidate]:
    """The candidates worth weighing: the simplest of those about as good as the best, then the next best.

    About as good means an error as small, or nearly all of what the best takes away; what the simpler one
    leaves can still be added.
    """
    first = min(close_to_best(standing, found), key=lambda c: (c.size, c.held_out))
    return [first, *(c for c in found if c is not first)][:TRIES]


def close_to_best(standing: Standing, found: Sequence[Candidate]) -> list[Candidate]:
    """The candidates about as good as the best."""
    best, before = found[0].held_out, standing.trial.held_out
    limit = max((1.0 + TIE) * best, before - MOST * (before - best))
    return [c for c in found if c.held_out <= limit]


@dataclass(frozen=True)
class Evidence:
    """What speaks for a candidate.

    Attributes:
        gain: share by which the error in held-out runs falls.
        sample_gain: the same, sample by sample.
        judged_gain: the same, of what is new in each sample.
        folds: share of the folds in which it falls.
        broad_gain: the judged gain without the few blocks that gain most.
        p_value: how often the best of all candidates does as well on noise.
        least_sample_gain: what is asked of `sample_gain`.
    """

    gain: float
    sample_gain: float
    judged_gain: float
    folds: float
    broad_gain: float
    p_value: float
    least_sample_gain: float = LEAST_SAMPLE_GAIN

    @property
    def enough(self) -> bool:
        """Whether the candidate is accepted."""
        gains = (
            (self.gain, LEAST_GAIN),
            (self.sample_gain, self.least_sample_gain),
            (self.judged_gain, LEAST_JUDGED_GAIN),
            (self.broad_gain, LEAST_BROAD_GAIN),
        )
        return (
            all(gain >= least for gain, least in gains)
            and self.folds >= LEAST_FOLDS
            and self.p_value <= LEVEL
        )


def evidence(
    before: Standing, after: Standing, found: Sequence[Candidate], chosen: Candidate, rng: np.random.Generator
) -> Evidence:
    """Weigh a candidate against chance, by the noise that is left once it is in the model.

    Args:
        before: without it.
        after: with it.
        found: all candidates that were tried.
        chosen: the one in question.
        rng: for the surrogates.
    """
    # all parameters fitted together may do better than one effect beside the others as they were
    best = min(chosen.search.held_out, after.trial.scores.held_out, key=np.sum)
    gain, folds = _gain(before, best)
    without = after.judge.fit(before.trial.columns, before.trial.target)
    judged_gain = _fall(without.held_out.sum(), after.judged.held_out)
    broad_gain = _broad(after.judge.whiten(before.trial.residual), after.judge.whiten(after.judged.residual))
    kept = after.plain.kept
    noise = surrogates(after.flexible.residual[kept], after.plain.frame.run[kept], rng)
    starts = (t.columns[kept] for c in found for t in c.search.starts)
    chance = best_gains(noise, before.trial.columns[kept], starts)
    # chance is as strong as the noise, not as all that is still missing
    observed = (before.trial.sse - after.trial.sse) / float(np.sum(after.flexible.residual[kept] ** 2))
    sample_gain = 1.0 - after.rmse / before.rmse
    return Evidence(
        gain,
        sample_gain,
        judged_gain,
        folds,
        broad_gain,
        p_value(observed, chance),
        least_sample_gain(before.data.kind),
    )


def least_sample_gain(kind: ChannelKind) -> float:
    """Share of the error, sample by sample, that an effect must take away."""
    return LEAST_SAMPLE_GAIN if kind is ChannelKind.CONTACT else LEAST_JOINT_SAMPLE_GAIN


def is_slight(start: Standing, before: Standing, held_out: float) -> bool:
    """Whether an effect takes away so little of all that is explained that another may just be imprecise.

    A strong effect that is computed from a motion measured with errors leaves a little of itself behind,
    for which some small effect always has the shape. Beside what fits only with a spring that pulls, nothing
    is slight: that is no strong effect, but one that imitates several.

    Args:
        start: the base model.
        before: the model without the effect.
        held_out: energy left with it.
    """
    little = before.trial.held_out - held_out < SLIGHT * (start.trial.held_out - held_out)
    return little and not is_beyond_bounds(before.trial)


def is_beyond_bounds(trial: Trial, noise: float = 0.0) -> bool:
    """Whether a gain of the model, its base included, is clearly outside its bounds: a spring that pulls.

    Args:
        trial: of the model.
        noise: effort that a gain may be beyond them for, where that is more than a share of the whole.
    """
    effort = max(noise, LOOSE * float(np.sqrt(np.mean(trial.target**2))))
    for (name, gain), column in zip(trial.model.gains.items(), trial.columns.T, strict=True):
        slack = 2.0 * trial.spread[name] + effort / max(float(np.sqrt(np.mean(column**2))), 1e-300)
        if not gain.lower - slack <= trial.parameters[name] <= gain.upper + slack:
            return True
    return False


def hopeless(before: Standing, chosen: Candidate) -> Evidence:
    """Evidence for a candidate whose gain is too small for the rest to be weighed: NaN."""
    gain, folds = _gain(before, chosen.search.held_out)
    return Evidence(gain, np.nan, np.nan, folds, np.nan, np.nan)


def _gain(before: Standing, held_out: FloatArray) -> tuple[float, float]:
    """Share by which the error in held-out runs falls, and share of the folds in which it does."""
    better = float(np.mean(held_out < before.trial.scores.held_out))
    return _fall(before.trial.held_out, held_out.sum()), better


def _broad(before: FloatArray, after: FloatArray) -> float:
    """Share by which the error (w,) falls without the blocks that gain most: a few may be an accident."""
    order = np.argsort(before**2 - after**2)[: max(len(before) - FEW, 1)]
    return _fall(float(np.sum(before[order] ** 2)), float(np.sum(after[order] ** 2)))


def _fall(before: float, after: float) -> float:
    return float(1.0 - np.sqrt(after / before)) if before > 0.0 else 0.0


def is_possible(effect: Effect, trial: Trial, bench: Bench, loose: float = 0.0) -> bool:
    """Whether the effect's parameters make physical sense, and what makes it what it is is there.

    A gain that the effect could do without may be beyond its bounds by no more than makes the noise.

    Args:
        effect: part of the model.
        trial: of the model.
        bench: where.
        loose: effort, as a share of the whole, that a gain may be beyond its bounds.
    """
    effort = loose * float(np.sqrt(np.mean(trial.target**2)))
    noise = float(np.sqrt(np.mean(trial.residual**2)))
    spread = trial.spread
    for column, parameter in zip(_own_columns(effect, trial).T, effect.gains, strict=True):
        name = f"{effect.name}.{parameter.name}"
        value, slack = trial.parameters[name], 2.0 * spread[name]
        minor = bool(effect.essential) and parameter.name not in effect.essential
        slack += (effort + minor * noise) / max(float(np.sqrt(np.mean(column**2))), 1e-300)
        if not parameter.lower - slack <= value <= parameter.upper + slack:
            return False
    # what ended at the far end of a range that goes by ratio was not found
    if any(p.log and trial.parameters[f"{effect.name}.{p.name}"] > FAR_END * p.upper for p in effect.inner):
        return False
    # no time stamp is better than half a step
    half = 0.5 * sample_time(bench.frame.data.time_s, bench.frame.data.run)
    if any(abs(trial.parameters[f"{effect.name}.{p.name}"]) < half for p in effect.inner if p.unit == "s"):
        return False
    simpler = effect.simpler(_own_columns(effect, trial))
    if simpler.shape[1] == len(effect.gains):
        return True
    others = trial.columns[:, ~_is_own(effect, trial)]
    without = bench.fit(np.column_stack([others, simpler]), trial.target)
    return float(without.sse.sum()) - trial.sse >= LEAST_GAIN * trial.sse


def _is_own(effect: Effect, trial: Trial) -> BoolArray:
    return np.array([name.startswith(f"{effect.name}.") for name in trial.model.gains], dtype=np.bool_)


def _own_columns(effect: Effect, trial: Trial) -> FloatArray:
    return trial.columns[:, _is_own(effect, trial)]
