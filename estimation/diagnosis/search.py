"""The search for effects: stepwise, looking back at each step, from several first effects if one misleads.

It goes ahead on a sketch of the channel, with one sample for each block and some of the runs where there are
many; what comes out is fitted again to all of it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import numpy as np

from estimation.channel import ChannelData
from estimation.diagnosis.candidates import (
    Candidate,
    bounds_passed,
    candidates,
    is_credible,
    is_misnamed,
    is_possible,
    size,
    try_all,
)
from estimation.diagnosis.doubt import SMALL
from estimation.effect import Effect, Inner, SensorEffect
from estimation.fit.chance import chance_gains
from estimation.fit.frame import Frame, coarse_copy
from estimation.fit.memory import Memory
from estimation.fit.standing import Fit, Standing, stand
from estimation.fit.trial import Trial, attempt
from estimation.model import Model
from estimation.signals.blocks import rows_of_runs
from estimation.signals.runwise import sample_time
from robot_io.types import BoolArray

TIE = 0.02  # of the squared error in held-out runs, that equally good models may differ by
LEVEL = 0.01  # of false alarms, over all candidates of a step
MOST_EFFECTS = 4  # with more, almost anything can be imitated
FITTED = 4  # candidates of a step of which all parameters are fitted together
FITTED_IN_FULL = 2  # the same where a sketch has chosen before
FIRSTS = 5  # first effects that are tried where the best one leads to no complete model
LOOKED_AT = 12  # candidates among which those are chosen
_PAIR = 2
BESIDE, PAIRS = 3, 4  # second effects looked at beside each first, and pairs that are fitted together
_FOLDS = 0.6  # share of the folds in which an effect must help
_CLEAR = 0.5  # of the energy that is left: noise of a thousand blocks and more gives no effect that much
_MANY = 1000
SHORTLIST = 8  # effects tried on all samples
_FINE = 4  # blocks within which a copy of blocks hardly tells times
NEAR = 1.5  # times the squared error that is left, from which another effect may get below it
_LITTLE = 0.2  # of the error, beyond which draws that show as much prove no more than that they are few
FEW_STARTS = 4  # places where a second effect is tried
_ENOUGH, _ENOUGH_RUNS = 2000, 12  # blocks and runs of a sketch
Progress = Callable[[str, float], None]
_Key = tuple[frozenset[tuple[str, int]], tuple[str, ...]]


@dataclass(frozen=True)
class Search:
    """A channel, its base model and the library; models that were fitted are remembered."""

    data: ChannelData  # the channel
    model: Model  # the base model
    good: BoolArray  # samples that are fit for use, shape (n,)
    effects: tuple[Effect, ...]  # the library
    rng: np.random.Generator  # for surrogates
    progress: Progress = lambda what, share: None  # told what is being done, and the share of it that is done
    # The same on a coarse copy of the channel, which says what is worth trying; None for a sketch.
    sketch: "Search | None" = None
    _memory: Memory = field(default_factory=Memory)
    _fits: dict[_Key, Standing] = field(default_factory=dict)
    _screened: dict[_Key, list[Candidate]] = field(default_factory=dict)
    _instead: dict[tuple[_Key, str], list[Candidate]] = field(default_factory=dict)

    @property
    def start(self) -> Standing:
        """The base model."""
        return self.fitted(self.model, {})

    def added(self, standing: Standing) -> list[str]:
        """Names of a model's effects beside the base model's."""
        base = {effect.name for effect in self.model.effects}
        return [effect.name for effect in standing.trial.model.effects if effect.name not in base]

    def size(self, standing: Standing) -> int:
        """Number of a model's parameters beside the base model's."""
        names = set(self.added(standing))
        return sum(size(effect) for effect in standing.trial.model.effects if effect.name in names)

    def fitted(self, model: Model, parameters: Mapping[str, float]) -> Standing:
        """A model, fitted from these parameters on unless it is known already; or from where a sketch led."""
        key = _key(model)
        if key not in self._fits:
            known = self.sketch and self.sketch._fits.get(key)
            self._fits[key] = self._stand(model, known.trial.parameters if known else parameters)
        return self._fits[key]

    def _stand(self, model: Model, parameters: Mapping[str, float]) -> Standing:
        """A model fitted, each base gain that an added effect turns beyond its bounds held at the bound.

        What a simple model says by a spring or a damper may be said by what is added: then there is none.
        """
        held = dict(self.model.held)
        while True:
            made = stand(self.data, replace(model, held=held), parameters, self.good, self._memory)
            beyond = {} if _key(model) == _key(self.model) else self._beyond(made.trial)
            if not beyond:
                return made
            held, parameters = held | beyond, made.trial.parameters

    def _beyond(self, trial: Trial) -> dict[str, float]:
        """Bounds of the base gains that are beyond them, and are not in the base model."""
        return {
            name: bound
            for effect in self.model.effects
            if not is_credible(effect, trial) and is_credible(effect, self.start.trial)
            for name, bound in bounds_passed(effect, trial).items()
        }

    def refitted(self, model: Model, parameters: Mapping[str, float]) -> Standing:
        """A model fitted from other parameters, and kept where that is better."""
        key, anew = _key(model), self._stand(model, parameters)
        known = self._fits.get(key)
        if known is None or anew.trial.sse < (1.0 - TIE) * known.trial.sse:
            self._fits[key] = anew
            self._screened.pop(key, None)
            for name in self.added(anew):
                self._instead.pop((key, name), None)
        return self._fits[key]

    def screened(self, standing: Standing) -> list[Candidate]:
        """All candidates beside a model, the best first."""
        key = _key(standing.trial.model)
        if key not in self._screened:
            beside = ", ".join(effect.name for effect in standing.trial.model.effects)
            what = f"{self.data.name}: beside {beside}"
            starts = self._shortlist(standing)
            tried = candidates(standing.data, standing.trial.model, self.effects)

            def places(effect: Effect) -> Sequence[Inner]:
                known = [] if starts is None else starts[effect.name]
                # a form that another model's signals call for may have other parameters
                fitting = [one for one in known if one.keys() == {p.name for p in effect.inner}]
                return fitting or effect.starts(standing.data)

            self._screened[key] = try_all(
                standing,
                [effect for effect in tried if starts is None or effect.name in starts],
                lambda share, name: self.progress(f"{what}: {name}", share),
                starts=places,
            )
        return self._screened[key]

    def _shortlist(self, standing: Standing) -> dict[str, list[Inner]] | None:
        """Where to try which effects, by what a coarse copy showed; None for all.

        What hardly shows there is tried as it proposes.
        """
        if self.sketch is None:
            return None
        rough = self.sketch.screened(self.sketch.fitted(standing.trial.model, standing.trial.parameters))
        starts = {}
        for number, candidate in enumerate(rough):
            effect, best = candidate.effect, candidate.search.best.parameters
            fine = self.fine_starts(standing, effect)
            if fine or number < SHORTLIST:
                starts[effect.name] = [{p.name: best[f"{effect.name}.{p.name}"] for p in effect.inner}, *fine]
        return starts

    def fine_starts(self, standing: Standing, effect: Effect) -> list[Inner]:
        """Starts that a coarse copy hardly shows: times within a few blocks, steps of single readings."""
        if not isinstance(effect, SensorEffect):
            return []
        starts = effect.starts(standing.data)
        if not effect.linear:
            return list(starts)
        fine_s = _FINE * standing.plain.frame.rows.shape[1] * sample_time(self.data.time_s, self.data.run)
        in_time = any(one.unit == "s" for one in effect.inner)
        return [one for one in starts if in_time and max(map(abs, one.values())) < fine_s]

    def refined(self, found: Standing) -> Standing:
        """A model that a coarse copy led to, with what hardly shows there fitted from its own starts too."""
        for effect in found.trial.model.effects:
            for start in self.fine_starts(found, effect) if effect.name in self.added(found) else ():
                own = {f"{effect.name}.{name}": value for name, value in start.items()}
                found = self.refitted(found.trial.model, {**found.trial.parameters, **own})
        return found

    def glanced(self, beside: Standing) -> list[Candidate]:
        """The possible candidates beside a model, tried in few places, the best first."""
        return _glance(beside, candidates(beside.data, beside.trial.model, self.effects))

    def instead(self, standing: Standing, name: str) -> list[Candidate]:
        """The possible candidates in the place of one effect, the best first, that one among them.

        All other parameters stay as they are: those that the model without the effect would have make up for
        it, and for nothing else.
        """
        key = _key(standing.trial.model), name
        if key not in self._instead:
            model, known = standing.trial.model.without(name), standing.trial.parameters
            less = Fit(standing.data, standing.plain, attempt(standing.plain, model, known))
            tried = candidates(standing.data, model, self.effects)
            if self.sketch is not None:
                rough = self.sketch.instead(self.sketch.fitted(standing.trial.model, known), name)
                likely = {one.effect.name for one in rough[:SHORTLIST]} | {name}
                tried = tuple(one for one in tried if one.name in likely)
            self._instead[key] = _glance(less, tried)
        return self._instead[key]

    def sought_again(self, standing: Standing, name: str) -> Standing:
        """A model with one effect looked for anew: beside the others its best place may be far away."""
        model, known = standing.trial.model, standing.trial.parameters
        (effect,) = (one for one in model.effects if one.name == name)
        if not effect.inner or self.sketch is not None:
            return standing
        less = Fit(standing.data, standing.plain, attempt(standing.plain, model.without(name), known))
        best = try_all(less, [effect])[0].search.best
        return self._fitted_from(best) if best.sse < (1.0 - TIE) * standing.trial.sse else standing

    def with_candidate(self, candidate: Candidate) -> Standing:
        """The model that a candidate was tried in, with all parameters fitted together."""
        return self._fitted_from(candidate.search.best)

    def without(self, standing: Standing, name: str) -> Standing:
        """A model less one effect."""
        return self._fitted_from(
            attempt(standing.plain, standing.trial.model.without(name), standing.trial.parameters)
        )

    def _fitted_from(self, trial: Trial) -> Standing:
        """The model of a trial, fitted anew where the trial alone is better than the fit that is known."""
        known = self._fits.get(_key(trial.model))
        if known is not None and trial.sse < (1.0 - TIE) * known.trial.sse:
            return self.refitted(trial.model, trial.parameters)
        return self.fitted(trial.model, trial.parameters)

    def extensions(self, standing: Standing, count: int = FITTED) -> list[Standing]:
        """A model with one more effect, all parameters fitted together, in the order of `ordered`."""
        count = count if self.sketch is None else min(count, FITTED_IN_FULL)
        made = (self.with_candidate(one) for one in self._promising(standing)[:count])
        return self.ordered([one for one in made if self.is_sensible(one)])

    def _promising(self, standing: Standing) -> list[Candidate]:
        """Candidates that lower the error once the model's other parameters follow, the best first."""
        possible = [one for one in self.screened(standing) if one.possible][:LOOKED_AT]
        follow = bool(standing.trial.model.inner)
        left = [one.followed(standing.plain) if follow else one.held_out for one in possible]
        order = sorted(range(len(possible)), key=lambda number: left[number])
        return [possible[i] for i in order if left[i] < (1.0 - TIE) * standing.trial.held_out]

    def is_sensible(self, standing: Standing) -> bool:
        """Whether added effects are what their names say, and turn no base gain beyond its bounds."""
        return all(self.is_sound(standing, effect.name) for effect in standing.trial.model.effects)

    def is_sound(self, standing: Standing, name: str) -> bool:
        """The same of one effect."""
        (effect,) = (one for one in standing.trial.model.effects if one.name == name)
        trial, bench = standing.trial, standing.plain
        if name in self.added(standing):
            return is_possible(effect, trial, bench) and not is_misnamed(effect, trial, bench)
        return is_credible(effect, trial) or not is_credible(effect, self.start.trial)

    def exchanged(self, standing: Standing, name: str) -> list[Standing]:
        """Models with another effect in the place of one, of those that may do better, in order."""
        tried = self.instead(standing, name)
        roughly = [one.held_out for one in tried if one.effect.name == name]  # in as few places as the others
        near = NEAR * max([standing.trial.held_out, *roughly])
        others = [one for one in tried if _key(one.search.best.model) != _key(standing.trial.model)]
        made = [self.with_candidate(one) for one in others[:2] if one.held_out < near]
        made += self._in_parts(standing, name)
        return self.ordered([one for one in made if self.is_sensible(one)])

    def _in_parts(self, standing: Standing, name: str) -> list[Standing]:
        """The model with the parts of an effect in its place, if it has any."""
        (effect,) = (one for one in standing.trial.model.effects if one.name == name)
        present = {one.name for one in standing.trial.model.effects}
        parts = [one for one in self.effects if one.name in effect.parts and one.name not in present]
        return [self.with_each(self.without(standing, name), parts)] if parts else []

    def with_each(self, standing: Standing, effects: Sequence[Effect]) -> Standing:
        """A model with these effects, one after the other, as far as the channel can have them."""
        for effect in effects:
            if effect.applies_to(standing.data):
                (tried,) = try_all(standing, [effect.suited_to(standing.data)])
                standing = self.with_candidate(tried)
        return standing

    def is_better(self, one: Standing, other: Standing) -> bool:
        """Whether a model leaves less than another; or about as much, with fewer parameters.

        More parameters must be worth it: by as much as an added effect.
        """
        more = np.sign(self.size(one) - self.size(other))
        limit = (1.0 - SMALL) ** (2.0 * more) if more else 1.0 - TIE
        return bool(one.trial.held_out < limit * other.trial.held_out)

    def ordered(self, made: Sequence[Standing]) -> list[Standing]:
        """By the error in held-out runs; of those as good as the best, those with fewest parameters first."""
        limit = (1.0 + TIE) * min((one.trial.held_out for one in made), default=0.0)

        def rank(one: Standing) -> tuple[bool, int, float]:
            tied = one.trial.held_out <= limit
            return not tied, self.size(one) if tied else 0, one.trial.held_out

        return sorted(made, key=rank)

    def is_needed(self, before: Standing, after: Standing) -> bool:
        """Whether an effect takes away more than a small share of the error, and more than chance would."""
        if after.rmse > (1.0 - SMALL) * before.rmse:
            return False
        if np.mean(after.trial.scores.held_out < before.trial.scores.held_out) < _FOLDS:
            return False
        return self.p_value(before, after) <= LEVEL

    def p_value(self, before: Standing, after: Standing) -> float:
        """How often the best of all candidates takes as much from noise; 0 where that is out of question."""
        kept = after.plain.kept
        noise = after.flexible.residual[kept]
        observed = (before.trial.sse - after.trial.sse) / max(float(noise @ noise), 1e-300)
        if observed > _CLEAR and len(noise) > _MANY:
            return 0.0
        starts = (trial for candidate in self.screened(before) for trial in candidate.search.starts)
        columns = (attempt(before.plain, one.model, one.parameters).columns[kept] for one in starts)
        run = after.plain.frame.run[kept]
        chance = chance_gains(noise, run, before.trial.columns[kept], columns, self.rng)
        return float((1 + np.sum(chance >= observed)) / (1 + len(chance)))


def search_of(  # noqa: PLR0917
    data: ChannelData,
    model: Model,
    good: BoolArray,
    effects: tuple[Effect, ...],
    rng: np.random.Generator,
    progress: Progress = lambda what, share: None,
) -> Search:
    """A search of a channel, with a sketch of it where blocks are longer than samples."""
    whole = Search(data, model, good, effects, rng, progress)
    frame = whole.start.plain.frame
    chosen = _some_runs(frame)
    if frame.rows.shape[1] == 1 and chosen.all():
        return whole
    rough = replace(coarse_copy(frame).select(chosen), shared=data.shared)
    return replace(whole, sketch=Search(rough, model, frame.trusted[chosen], effects, rng, progress))


def _some_runs(frame: Frame) -> BoolArray:
    """Blocks of runs that are enough to say what is worth trying, weak and strong ones alike, shape (m,)."""
    runs = rows_of_runs(frame.run)
    every = max(min(len(frame) // _ENOUGH, len(runs) // _ENOUGH_RUNS), 1)
    by_effort = sorted(runs, key=lambda rows: float(np.ptp(frame.effort[rows])))
    chosen = np.zeros(len(frame), dtype=np.bool_)
    chosen[np.concatenate(by_effort[every // 2 :: every])] = True
    return chosen


def search(
    whole: Search, is_complete: Callable[[Standing], bool], sufficient: Callable[[Standing], Standing]
) -> Standing:
    """The model that explains most, each of its effects needed beside the others.

    Many effects imitate almost anything: where more than two are needed, pairs are tried as well.

    Args:
        whole: the channel.
        is_complete: whether a model leaves no more than draws from it do.
        sufficient: the part of a model from which draws gain as much by the whole.
    """
    sketch = whole.sketch or whole
    on_all = partial(_refined, whole)

    def is_enough(found: Standing) -> bool:
        needs_nothing = not whole.added(found) or found.rmse <= (1.0 + SMALL) * found.floor()
        return (needs_nothing or found.left_of_blocks() < _LITTLE) and is_complete(found)

    best = on_all(_climb(sketch, sketch.start))
    enough = is_enough(best)
    if enough and len(whole.added(best)) > _PAIR:
        best = looked_back(whole, sufficient(best))
        enough = is_enough(best)
    if enough and len(whole.added(best)) <= _PAIR:
        return best
    firsts = [] if enough else sketch.extensions(sketch.start, FIRSTS)
    for first in (*firsts, *_pairs(sketch)):
        if set(sketch.added(first)) <= set(whole.added(best)):
            continue
        rough = _climb(sketch, first)
        if not sketch.is_sensible(rough):
            continue
        known = sketch.fitted(best.trial.model, best.trial.parameters)
        if rough.trial.held_out < (1.0 - TIE) * known.trial.held_out:
            best = whole.ordered([best, on_all(rough)])[0]
            if is_enough(best):
                break
    return best


def _pairs(sketch: Search) -> Iterator[Standing]:
    """Two effects at once, the best pairs first: beside the wrong first, the right second does little."""
    beside = [
        (first, second)
        for first in sketch.screened(sketch.start)
        if first.possible
        for second in sketch.glanced(sketch.with_candidate(first))[:BESIDE]
    ]
    beside.sort(key=lambda pair: pair[1].held_out)
    made = (sketch.with_candidate(second) for _, second in beside[:LOOKED_AT])
    yield from islice((one for one in made if sketch.is_sensible(one)), PAIRS)


def _refined(whole: Search, rough: Standing) -> Standing:
    """What was found on a coarse copy, on the channel itself."""
    found = whole.fitted(rough.trial.model, rough.trial.parameters)
    return _climb(whole, looked_back(whole, whole.refined(found)))


def _climb(search: Search, standing: Standing) -> Standing:
    """Add the best effect as long as one is needed, and look back at each step."""
    while len(search.added(standing)) < MOST_EFFECTS:
        further = (one for one in search.extensions(standing) if search.is_needed(standing, one))
        found = next(further, None)
        if found is None:
            break
        settled = looked_back(search, found)
        if settled.trial.held_out >= standing.trial.held_out:
            break
        standing = settled
    return standing


def looked_back(search: Search, standing: Standing) -> Standing:
    """Seek each effect anew, drop it if needless, and exchange it where another does better, or is sound."""
    for name in search.added(standing):
        standing = search.sought_again(standing, name)
        less = search.without(standing, name)
        if not search.is_needed(less, standing):
            standing = less
            continue
        is_sound = search.is_sound(standing, name)
        better = (
            one for one in search.exchanged(standing, name) if not is_sound or search.is_better(one, standing)
        )
        standing = next(better, standing if is_sound else less)
    return standing


def _glance(beside: Fit, effects: Sequence[Effect]) -> list[Candidate]:
    """Those of some effects that are possible beside a fit, tried in few places, the best first."""

    def few(effect: Effect) -> Sequence[Inner]:
        starts = effect.starts(beside.data)
        return starts[:: max(len(starts) // FEW_STARTS, 1)]

    return [one for one in try_all(beside, effects, starts=few, refined=0) if one.possible]


def _key(model: Model) -> _Key:
    """Effects add up in any order; what sensors do does not."""
    sensors = tuple(effect.name for effect in model.effects if isinstance(effect, SensorEffect))
    return frozenset((effect.name, effect.form) for effect in model.effects), sensors
