"""The search for effects: stepwise, looking back at each step, from several first effects if one misleads.

It goes ahead on a sketch of the channel, with one sample for each block and some of the runs where there are
many; what comes out is fitted again to all of it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.diagnosis.bootstrap import SMALL
from palpate.estimation.diagnosis.candidates import (
    Candidate,
    applicable_effects,
    is_misnamed,
    is_possible,
    parameter_count,
    screen_effects,
)
from palpate.estimation.effect import Effect, Inner, SensorEffect
from palpate.estimation.effects.run_differences import RunVariation
from palpate.estimation.fit.blocks import BlockedData, decimate, merge_blocks
from palpate.estimation.fit.fit_problem import Solution, columns_at, solve_gains
from palpate.estimation.fit.fit_result import FitResult, fit_model
from palpate.estimation.fit.permutation import COUNT, null_improvements
from palpate.estimation.model import Model
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.cache_by_array import FitCache
from palpate.estimation.signals.runwise import sample_time
from palpate.robot_io.types import BoolArray

TIE = 0.02  # of the squared error in held-out runs, that equally good models may differ by
LEVEL = 0.01  # of false alarms, over all candidates of a step
MOST_EFFECTS = 4  # with more, almost anything can be imitated
FITTED = 4  # candidates of a step of which all parameters are fitted together
FITTED_IN_FULL = 2  # the same where a sketch has chosen before
LOOKED_AT = 12  # candidates among which those are chosen
_PAIR = 2
BESIDE, PAIRS = 3, 4  # second effects looked at beside each first, and pairs that are fitted together
_FOLDS = 0.6  # share of the folds in which an effect must help
# Of the energy that is left: noise of a thousand blocks gives no effect that much, noise of more blocks less.
_CLEAR, _LEAST_CLEAR = 0.5, 0.1
_MANY = 1000
SHORTLIST = 8  # effects tried on all samples
_FINE = 4  # blocks within which a copy of blocks hardly tells times
NEAR = 1.5  # times the squared error that is left, from which another effect may get below it
_LITTLE = 0.2  # of the error, beyond which draws that show as much prove no more than that they are few
FEW_STARTS = 4  # places where a second effect is tried
_ENOUGH, _ENOUGH_RUNS = 2000, 12  # blocks and runs of a sketch
_MOST_BLOCKS = 12000  # of a sketch, before runs are chosen
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
    coarse: "Search | None" = None
    _cache: FitCache = field(default_factory=FitCache)
    _fits: dict[_Key, FitResult] = field(default_factory=dict)
    _screened: dict[_Key, list[Candidate]] = field(default_factory=dict)
    _alternatives: dict[tuple[_Key, str], list[Candidate]] = field(default_factory=dict)

    @property
    def start(self) -> FitResult:
        """The base model."""
        return self.fitted(self.model, {})

    def added_effects(self, fit: FitResult) -> list[str]:
        """Names of a model's effects beside the base model's.

        Args:
            fit: the model.
        """
        base = {effect.name for effect in self.model.effects}
        return [effect.name for effect in fit.solution.model.effects if effect.name not in base]

    def size(self, fit: FitResult) -> int:
        """Number of a model's parameters beside the base model's.

        Args:
            fit: the model.
        """
        names = set(self.added_effects(fit))
        return sum(parameter_count(effect) for effect in fit.solution.model.effects if effect.name in names)

    def fitted(self, model: Model, parameters: Mapping[str, float]) -> FitResult:
        """A model, fitted from these parameters on unless it is known already; or from where a sketch led.

        Args:
            model: to be fitted.
            parameters: where the fit starts, by "effect.parameter".
        """
        key = _key(model)
        if key not in self._fits:
            known = self.coarse and self.coarse._fits.get(key)
            start = known.solution.parameters if known else parameters
            self._fits[key] = fit_model(self.data, model, start, self.good, self._cache)
        return self._fits[key]

    def refitted(self, model: Model, parameters: Mapping[str, float]) -> FitResult:
        """A model fitted from other parameters, and kept where that is better.

        Args:
            model: to be fitted.
            parameters: where the fit starts, by "effect.parameter".
        """
        key, anew = _key(model), fit_model(self.data, model, parameters, self.good, self._cache)
        known = self._fits.get(key)
        if known is None or anew.solution.sse < (1.0 - TIE) * known.solution.sse:
            self._fits[key] = anew
            self._screened.pop(key, None)
            for name in self.added_effects(anew):
                self._alternatives.pop((key, name), None)
        return self._fits[key]

    def screen(self, fit: FitResult) -> list[Candidate]:
        """All candidates beside a model, the best first.

        Args:
            fit: the model to extend.
        """
        key = _key(fit.solution.model)
        if key not in self._screened:
            beside = ", ".join(effect.name for effect in fit.solution.model.effects)
            what = f"{self.data.name}: beside {beside}"
            starts = self._shortlist(fit)
            tried = applicable_effects(fit.data, fit.solution.model, self.effects)

            def places(effect: Effect) -> Sequence[Inner]:
                known = [] if starts is None else starts[effect.name]
                # a form that another model's signals call for may have other parameters
                fitting = [start for start in known if start.keys() == {p.name for p in effect.inner}]
                return fitting or effect.starts(fit.data)

            self._screened[key] = screen_effects(
                fit,
                [effect for effect in tried if starts is None or effect.name in starts],
                lambda share, name: self.progress(f"{what}: {name}", share),
                starts=places,
            )
        return self._screened[key]

    def _shortlist(self, fit: FitResult) -> dict[str, list[Inner]] | None:
        """Where to try which effects, by what a coarse copy showed; None for all.

        What hardly shows there is tried as it proposes.
        """
        if self.coarse is None:
            return None
        rough = self.coarse.screen(self.coarse.fitted(fit.solution.model, fit.solution.parameters))
        starts = {}
        for number, candidate in enumerate(rough):
            effect, best = candidate.effect, candidate.search.best.parameters
            fine = self.fine_starts(fit, effect)
            if fine or number < SHORTLIST:
                starts[effect.name] = [{p.name: best[f"{effect.name}.{p.name}"] for p in effect.inner}, *fine]
        return starts

    def fine_starts(self, fit: FitResult, effect: Effect) -> list[Inner]:
        """Starts that a coarse copy hardly shows: times within a few blocks, steps of single readings.

        Args:
            fit: a model of the channel.
            effect: of which starts are chosen.
        """
        if not isinstance(effect, SensorEffect):
            return []
        starts = effect.starts(fit.data)
        if not effect.linear:
            return list(starts)
        fine_s = _FINE * fit.problem.blocked.rows.shape[1] * sample_time(self.data.time_s, self.data.run)
        in_time = any(parameter.unit == "s" for parameter in effect.inner)
        return [start for start in starts if in_time and max(map(abs, start.values())) < fine_s]

    def refined(self, fitted: FitResult) -> FitResult:
        """A model that a coarse copy led to, with what hardly shows there fitted from its own starts too.

        Args:
            fitted: the model.
        """
        for name in self.added_effects(fitted):
            model, known = fitted.solution.model, fitted.solution.parameters
            effect = model.effect(name)
            tried = [
                solve_gains(fitted.problem, model, {**known, **{f"{name}.{n}": v for n, v in start.items()}})
                for start in self.fine_starts(fitted, effect)
            ]
            best = min(tried, key=lambda solution: solution.sse, default=fitted.solution)
            if best is not fitted.solution and best.sse < NEAR * fitted.solution.sse:
                fitted = self.refitted(model, best.parameters)
        return fitted

    def quick_screen(self, beside: FitResult) -> list[Candidate]:
        """The possible candidates beside a model, tried in few places, the best first.

        Args:
            beside: the model to extend.
        """
        return _quick_screen(beside, applicable_effects(beside.data, beside.solution.model, self.effects))

    def alternatives(self, fit: FitResult, name: str) -> list[Candidate]:
        """The possible candidates in the place of one effect, the best first, that one among them.

        All other parameters stay as they are: those that the model without the effect would have make up for
        it, and for nothing else.

        Args:
            fit: the model.
            name: the effect that is replaced.
        """
        key = _key(fit.solution.model), name
        if key not in self._alternatives:
            model, known = fit.solution.model.without(name), fit.solution.parameters
            less = FitResult(fit.data, fit.problem, solve_gains(fit.problem, model, known))
            tried = applicable_effects(fit.data, model, self.effects)
            if self.coarse is not None:
                rough = self.coarse.alternatives(self.coarse.fitted(fit.solution.model, known), name)
                likely = {candidate.effect.name for candidate in rough[:SHORTLIST]} | {name}
                tried = tuple(candidate for candidate in tried if candidate.name in likely)
            self._alternatives[key] = _quick_screen(less, tried)
        return self._alternatives[key]

    def refit_effect(self, fit: FitResult, name: str) -> FitResult:
        """A model with one effect looked for anew: beside the others its best place may be far away.

        Args:
            fit: the model.
            name: the effect.
        """
        model, known = fit.solution.model, fit.solution.parameters
        effect = model.effect(name)
        if not effect.inner or self.coarse is not None:
            return fit
        less = FitResult(fit.data, fit.problem, solve_gains(fit.problem, model.without(name), known))
        best = screen_effects(less, [effect])[0].search.best
        return self._fitted_from(best) if best.sse < (1.0 - TIE) * fit.solution.sse else fit

    def with_candidate(self, candidate: Candidate) -> FitResult:
        """The model that a candidate was tried in, with all parameters fitted together.

        Args:
            candidate: the effect, with the model in which it was tried.
        """
        return self._fitted_from(candidate.search.best)

    def without(self, fit: FitResult, name: str) -> FitResult:
        """A model less one effect.

        Args:
            fit: the model.
            name: the effect to drop.
        """
        return self._fitted_from(
            solve_gains(fit.problem, fit.solution.model.without(name), fit.solution.parameters)
        )

    def _fitted_from(self, solution: Solution) -> FitResult:
        """The model of a trial, fitted anew where the trial alone is better than the fit that is known."""
        known = self._fits.get(_key(solution.model))
        if known is not None and solution.sse < (1.0 - TIE) * known.solution.sse:
            return self.refitted(solution.model, solution.parameters)
        return self.fitted(solution.model, solution.parameters)

    def extensions(self, fit: FitResult, count: int = FITTED) -> list[FitResult]:
        """A model with one more effect, all parameters fitted together, in the order of `ordered`.

        Args:
            fit: the model to extend.
            count: of candidates that are fitted.
        """
        count = count if self.coarse is None else min(count, FITTED_IN_FULL)
        # Candidates that lower the error once the model's other parameters follow, the best first.
        possible = [candidate for candidate in self.screen(fit) if candidate.possible][:LOOKED_AT]
        follow = bool(fit.solution.model.inner)
        left = [candidate.followed(fit.problem) if follow else candidate.held_out for candidate in possible]
        order = sorted(range(len(possible)), key=lambda number: left[number])
        limit = (1.0 - TIE) * fit.solution.held_out
        made = (self.with_candidate(possible[i]) for i in [i for i in order if left[i] < limit][:count])
        return self.ordered([extension for extension in made if self.is_sensible(extension)])

    def is_sensible(self, fit: FitResult) -> bool:
        """Whether added effects are what their names say.

        Args:
            fit: the model.
        """
        return all(self.is_sound(fit, name) for name in self.added_effects(fit))

    def is_sound(self, fit: FitResult, name: str) -> bool:
        """Whether one effect is what its name says.

        Args:
            fit: the model.
            name: the effect.
        """
        effect = fit.solution.model.effect(name)
        solution, problem = fit.solution, fit.problem
        if isinstance(effect, RunVariation):
            inner = {
                parameter.name: solution.parameters[f"{name}.{parameter.name}"] for parameter in effect.inner
            }
            less = solve_gains(problem, solution.model.without(name), solution.parameters)
            expected = less.model.predict(fit.data, less.parameters)
            if effect.is_common(expected, fit.data, inner) or effect.is_gradual(expected, fit.data, inner):
                return False
        return is_possible(effect, solution, problem) and not is_misnamed(effect, solution, problem)

    def substitutions(self, fit: FitResult, name: str) -> list[FitResult]:
        """Models with another effect in the place of one, of those that may do better, in order.

        Args:
            fit: the model.
            name: the effect that is replaced.
        """
        tried = self.alternatives(fit, name)
        roughly = [
            candidate.held_out for candidate in tried if candidate.effect.name == name
        ]  # in as few places as the others
        near = NEAR * max([fit.solution.held_out, *roughly])
        others = [
            candidate for candidate in tried if _key(candidate.search.best.model) != _key(fit.solution.model)
        ]
        made = [self.with_candidate(candidate) for candidate in others[:2] if candidate.held_out < near]
        # The model with the parts of an effect in its place, if it has any.
        effect = fit.solution.model.effect(name)
        present = {effect_there.name for effect_there in fit.solution.model.effects}
        parts = [part for part in self.effects if part.name in effect.parts and part.name not in present]
        made += [self.with_each(self.without(fit, name), parts)] if parts else []
        return self.ordered([substitute for substitute in made if self.is_sensible(substitute)])

    def with_each(self, fit: FitResult, effects: Sequence[Effect]) -> FitResult:
        """A model with these effects, one after the other, as far as the channel can have them.

        Args:
            fit: the model to extend.
            effects: to be added.
        """
        for effect in effects:
            if effect.applies_to(fit.data):
                (tried,) = screen_effects(fit, [effect.suited_to(fit.data)])
                fit = self.with_candidate(tried)
        return fit

    def is_better(self, fit: FitResult, reference: FitResult) -> bool:
        """Whether a model leaves less than another; or about as much, with fewer parameters.

        More parameters must be worth it: by as much as an added effect.

        Args:
            fit: the model.
            reference: the other model, fitted to the same data.
        """
        more = np.sign(self.size(fit) - self.size(reference))
        limit = (1.0 - SMALL) ** (2.0 * more) if more else 1.0 - TIE
        return bool(fit.solution.held_out < limit * reference.solution.held_out)

    def ordered(self, made: Sequence[FitResult]) -> list[FitResult]:
        """By the error in held-out runs; of those as good as the best, those with fewest parameters first.

        Args:
            made: fitted models of the channel.
        """
        limit = (1.0 + TIE) * min((fit.solution.held_out for fit in made), default=0.0)

        def rank(fit: FitResult) -> tuple[bool, int, float]:
            tied = fit.solution.held_out <= limit
            return not tied, self.size(fit) if tied else 0, fit.solution.held_out

        return sorted(made, key=rank)

    def is_needed(self, before: FitResult, after: FitResult) -> bool:
        """Whether an effect takes away more than a small share of the error, and more than chance would.

        Args:
            before: the model without the effect.
            after: the model with it.
        """
        if after.rmse > (1.0 - SMALL) * before.rmse:
            return False
        if np.mean(after.solution.linear_fit.held_out < before.solution.linear_fit.held_out) < _FOLDS:
            return False
        return self.p_value(before, after, LEVEL) <= LEVEL

    def p_value(self, before: FitResult, after: FitResult, level: float = 1.0) -> float:
        """How often the best of all candidates takes as much from noise; 0 where that is out of question.

        Args:
            before: a model.
            after: the model with one effect more.
            level: above it the value may come out too low, as long as it is above.
        """
        kept = after.problem.used
        noise = after.flexible.residual[kept]
        observed = (before.solution.sse - after.solution.sse) / max(float(noise @ noise), 1e-300)
        if len(noise) > _MANY and observed > max(_CLEAR * _MANY / len(noise), _LEAST_CLEAR):
            return 0.0
        starts = (solution for candidate in self.screen(before) for solution in candidate.search.starts)
        columns = (
            columns_at(before.problem, solution.model, solution.parameters)[kept] for solution in starts
        )
        run, base = after.problem.blocked.run[kept], before.solution.columns[kept]
        most = int(level * (1 + COUNT)) - 1
        chance = null_improvements(noise, run, base, columns, self.rng, observed=observed, most=most)
        return float((1 + np.sum(chance >= observed)) / (1 + len(chance)))


def prepare_search(  # noqa: PLR0917
    data: ChannelData,
    model: Model,
    good: BoolArray,
    effects: tuple[Effect, ...],
    rng: np.random.Generator,
    progress: Progress = lambda what, share: None,
) -> Search:
    """A search of a channel, with a sketch of it where blocks are longer than samples.

    Args:
        data: the channel.
        model: the base model.
        good: samples fit for use, shape (n,).
        effects: the library.
        rng: for draws.
        progress: called with the current step and the share of it that is done.
    """
    whole = Search(data, model, good, effects, rng, progress)
    blocked = merge_blocks(whole.start.problem.blocked, _MOST_BLOCKS)
    chosen = _some_runs(blocked)
    if blocked.rows.shape[1] == 1 and chosen.all():
        return whole
    rough = replace(decimate(blocked).select(chosen), shared=data.shared)
    return replace(whole, coarse=Search(rough, model, blocked.trusted[chosen], effects, rng, progress))


def _some_runs(blocked: BlockedData) -> BoolArray:
    """Blocks of runs that are enough to say what is worth trying, weak and strong ones alike, shape (m,)."""
    runs = rows_of_runs(blocked.run)
    every = max(min(len(blocked) // _ENOUGH, len(runs) // _ENOUGH_RUNS), 1)
    by_effort = sorted(runs, key=lambda rows: float(np.ptp(blocked.effort[rows])))
    chosen = np.zeros(len(blocked), dtype=np.bool_)
    chosen[np.concatenate(by_effort[every // 2 :: every])] = True
    return chosen


def select_effects(
    whole: Search,
    is_complete: Callable[[FitResult], bool],
    sufficient: Callable[[FitResult], FitResult],
    forms: Callable[[], FitResult],
) -> FitResult:
    """The model that explains most, each of its effects needed beside the others.

    Many effects imitate almost anything: where more than two are needed, pairs are tried as well. Where the
    best effects one by one leave something, the best forms of all kinds together are tried.

    Args:
        whole: the channel.
        is_complete: whether a model leaves no more than draws from it do.
        sufficient: the part of a model from which draws gain as much by the whole.
        forms: the model, on the coarse copy, with the best form of each kind that accounts for the error.
    """
    coarse = whole.coarse or whole
    on_all = partial(_refined, whole)

    def is_enough(fit: FitResult) -> bool:
        needs_nothing = not whole.added_effects(fit) or fit.rmse <= (1.0 + SMALL) * fit.floor()
        return (needs_nothing or fit.explainable_share() < _LITTLE) and is_complete(fit)

    best = on_all(_forward_selection(coarse, coarse.start))
    if not is_enough(best):
        best = whole.ordered([best, on_all(_forward_selection(coarse, backward_step(coarse, forms())))])[0]
    enough = is_enough(best)
    if enough and len(whole.added_effects(best)) > _PAIR:
        less = backward_step(whole, sufficient(best))
        best = less if is_enough(less) else best
    if not enough or len(whole.added_effects(best)) <= _PAIR:
        return best
    for first in _pairs(coarse):
        if set(coarse.added_effects(first)) <= set(whole.added_effects(best)):
            continue
        rough = _forward_selection(coarse, first)
        if not coarse.is_sensible(rough):
            continue
        known = coarse.fitted(best.solution.model, best.solution.parameters)
        if rough.solution.held_out < (1.0 - TIE) * known.solution.held_out:
            best = whole.ordered([best, on_all(rough)])[0]
            if is_enough(best):
                break
    return best


def _pairs(coarse: Search) -> Iterator[FitResult]:
    """Two effects at once, the best pairs first: beside the wrong first, the right second does little."""
    beside = [
        (first, second)
        for first in coarse.screen(coarse.start)
        if first.possible
        for second in coarse.quick_screen(coarse.with_candidate(first))[:BESIDE]
    ]
    beside.sort(key=lambda pair: pair[1].held_out)
    made = (coarse.with_candidate(second) for _, second in beside[:LOOKED_AT])
    yield from islice((fit for fit in made if coarse.is_sensible(fit)), PAIRS)


def _refined(whole: Search, rough: FitResult) -> FitResult:
    """What was found on a coarse copy, on the channel itself."""
    refined = whole.refined(whole.fitted(rough.solution.model, rough.solution.parameters))
    if whole.added_effects(refined) and refined.explainable_share() > _LITTLE:
        return refined
    return _forward_selection(whole, backward_step(whole, refined))


def _forward_selection(search: Search, fit: FitResult) -> FitResult:
    """Add the best effect as long as one is needed, and look back at each step."""
    while len(search.added_effects(fit)) < MOST_EFFECTS:
        further = (extension for extension in search.extensions(fit) if search.is_needed(fit, extension))
        extension = next(further, None)
        if extension is None:
            break
        settled = backward_step(search, extension)
        if settled.solution.held_out >= fit.solution.held_out:
            break
        fit = settled
    return fit


def backward_step(search: Search, fit: FitResult) -> FitResult:
    """Seek each effect anew, drop it if needless, and exchange it where another does better, or is sound.

    Args:
        search: of the channel.
        fit: the model with its effects.
    """
    for name in search.added_effects(fit):
        fit = search.refit_effect(fit, name)
        less = search.without(fit, name)
        if not search.is_needed(less, fit):
            fit = less
            continue
        is_sound = search.is_sound(fit, name)
        better = (
            substitute
            for substitute in search.substitutions(fit, name)
            if not is_sound or search.is_better(substitute, fit)
        )
        fit = next(better, fit if is_sound else less)
    return fit


def _quick_screen(beside: FitResult, effects: Sequence[Effect]) -> list[Candidate]:
    """Those of some effects that are possible beside a fit, tried in few places, the best first."""

    def few(effect: Effect) -> Sequence[Inner]:
        starts = effect.starts(beside.data)
        return starts[:: max(len(starts) // FEW_STARTS, 1)]

    return [
        candidate
        for candidate in screen_effects(beside, effects, starts=few, refined=0)
        if candidate.possible
    ]


def _key(model: Model) -> _Key:
    """Effects add up in any order; what sensors do does not."""
    sensors = tuple(effect.name for effect in model.effects if isinstance(effect, SensorEffect))
    return frozenset((effect.name, effect.form) for effect in model.effects), sensors
