"""Stepwise search for effects with backward elimination, also from the best pair if single effects fail.

The search starts on a coarse copy of the channel with one sample per block, and with part of the runs if
there are many. The resulting model is then fitted to all data.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.diagnosis.candidates import (
    Candidate,
    applicable_effects,
    is_misnamed,
    is_possible,
    parameter_count,
    quick_screen,
    screen_effects,
    start_columns,
)
from palpate.estimation.effect import Effect, Inner, SensorEffect
from palpate.estimation.effects.run_differences import RunVariation
from palpate.estimation.fit.blocks import BlockedData, block_average, decimate, merge_blocks
from palpate.estimation.fit.fit_problem import Solution, solve_gains
from palpate.estimation.fit.fit_result import FitResult, fit_model
from palpate.estimation.fit.permutation import COUNT, null_improvements
from palpate.estimation.model import Model, own_parameters
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.cache_by_array import FitCache
from palpate.estimation.signals.runwise import sample_time
from palpate.robot_io.types import BoolArray

TIE = 0.02  # relative difference of the squared held-out error below which models are equally good
LEVEL = 0.01  # family-wise false-alarm rate over all candidates of a step
MOST_EFFECTS = 4  # a model with more effects imitates almost any error
FITTED = 4  # candidates per step that are fitted jointly with all parameters
FITTED_IN_FULL = 2  # the same on all data, after a search on a coarse copy
LOOKED_AT = 12  # best candidates from which these are chosen
_PAIR = 2
_MAX_LEFT = 0.5  # share of the squared error above which a search for single effects has failed
BESIDE = 3  # second effects tried with each first effect
_FOLDS = 0.6  # least share of the folds in which an effect must lower the error
# Least improvement, relative to the residual energy, that needs no permutation test. It is `_CLEAR` for
# `_MANY_BLOCKS` blocks, inversely proportional to the number of blocks, and never below `_MIN_CLEAR`.
_CLEAR, _MIN_CLEAR = 0.5, 0.1
_MANY_BLOCKS = 1000
SHORTLIST = 8  # best candidates of the coarse copy that are tried on all samples
_FINE = 4  # duration in blocks below which a coarse copy does not resolve times
NEAR = 1.5  # ratio of squared errors up to which a joint fit may still make an alternative better
_LITTLE = 0.2  # explainable share of the error above which a nonsignificant bootstrap test may lack power
_COARSE_BLOCKS, _COARSE_RUNS = 2000, 12  # blocks and runs of a coarse copy
_MAX_BLOCKS = 12000  # largest number of blocks of a coarse copy before runs are selected
Progress = Callable[[str, float], None]
_Key = tuple[frozenset[tuple[str, int]], tuple[str, ...]]


@dataclass(frozen=True)
class Search:
    """Search for effects in one channel, with a cache of all fitted models."""

    data: ChannelData
    model: Model  # the base model
    good: BoolArray  # samples that a fit may use, shape (n,)
    effects: tuple[Effect, ...]  # the library of candidate effects
    rng: np.random.Generator  # for permutation and bootstrap tests
    progress: Progress = lambda what, share: None  # callback: current step and its completed share
    coarse: "Search | None" = None  # search on a coarse copy, which preselects candidates; None within a copy
    _cache: FitCache = field(default_factory=FitCache)
    _fits: dict[_Key, FitResult] = field(default_factory=dict)
    _screened: dict[_Key, list[Candidate]] = field(default_factory=dict)
    _alternatives: dict[tuple[_Key, str], list[Candidate]] = field(default_factory=dict)
    _significant: dict[tuple[FitResult, FitResult], bool] = field(default_factory=dict)
    # Model in which a forward selection ended, by each model that it passed.
    selected: dict[FitResult, FitResult] = field(default_factory=dict)
    # Models with one more effect of the library, as `fit_extended` fits them, by the model and the effect.
    extended: dict[tuple[FitResult, str], FitResult] = field(default_factory=dict)

    @property
    def start(self) -> FitResult:
        """The fitted base model."""
        return self.fitted(self.model, {})

    def excluding(self, name: str) -> "Search":
        """Return a search without one effect of the library, which keeps the fitted models.

        Args:
            name: name of the effect.
        """
        others = tuple(effect for effect in self.effects if effect.name != name)
        coarse, kept = self.coarse and self.coarse.excluding(name), (self._cache, self._fits)
        return Search(self.data, self.model, self.good, others, self.rng, self.progress, coarse, *kept)

    def added_effects(self, fit: FitResult) -> list[str]:
        """Return the names of a model's effects that are not in the base model.

        Args:
            fit: the model.
        """
        base = {effect.name for effect in self.model.effects}
        return [effect.name for effect in fit.solution.model.effects if effect.name not in base]

    def size(self, fit: FitResult) -> int:
        """Return the number of parameters of a model's added effects.

        Args:
            fit: the model.
        """
        names = set(self.added_effects(fit))
        return sum(parameter_count(effect) for effect in fit.solution.model.effects if effect.name in names)

    def fitted(self, model: Model, parameters: Mapping[str, float]) -> FitResult:
        """Fit a model, or return the cached fit.

        Args:
            model: the model to fit.
            parameters: start values by "effect.parameter"; a fit to the coarse copy takes precedence.
        """
        key = _key(model)
        if key not in self._fits:
            known = self.coarse and self.coarse._fits.get(key)
            start = known.solution.parameters if known else parameters
            self._fits[key] = fit_model(self.data, model, start, self.good, self._cache)
        return self._fits[key]

    def refitted(self, model: Model, parameters: Mapping[str, float]) -> FitResult:
        """Fit a model again from other start values, and keep the better fit; the base model keeps its own.

        Args:
            model: the model to fit.
            parameters: start values by "effect.parameter".
        """
        key = _key(model)
        if key == _key(self.model):
            return self.start
        known, new_fit = self._fits.get(key), fit_model(self.data, model, parameters, self.good, self._cache)
        if known is None or new_fit.solution.sse < (1.0 - TIE) * known.solution.sse:
            self._fits[key] = new_fit
            self._screened.pop(key, None)
            for name in self.added_effects(new_fit):
                self._alternatives.pop((key, name), None)
        return self._fits[key]

    def screen(self, fit: FitResult) -> list[Candidate]:
        """Return all candidates that extend a model, the best first.

        Args:
            fit: the model to extend.
        """
        key = _key(fit.solution.model)
        if key not in self._screened:
            parent = ", ".join(effect.name for effect in fit.solution.model.effects)
            what = f"{self.data.name}: beside {parent}"
            starts = self._shortlist(fit)
            tried = applicable_effects(fit.data, fit.solution.model, self.effects)

            def start_values(effect: Effect) -> Sequence[Inner]:
                known = [] if starts is None else starts[effect.name]
                # The form for another model's signals may have other parameters.
                fitting = [start for start in known if start.keys() == {p.name for p in effect.inner}]
                return fitting or effect.starts(fit.data)

            self._screened[key] = screen_effects(
                fit,
                [effect for effect in tried if starts is None or effect.name in starts],
                lambda share, name: self.progress(f"{what}: {name}", share),
                starts=start_values,
                restarted=[
                    effect.name
                    for effect in self.model.effects
                    if any(p.lower >= 0.0 for p in effect.inner)  # offsets are set to zero anyway
                    and not isinstance(effect, RunVariation)
                    and self.model.held.keys().isdisjoint(f"{effect.name}.{p.name}" for p in effect.inner)
                ],
            )
        return self._screened[key]

    def _shortlist(self, fit: FitResult) -> dict[str, list[Inner]] | None:
        """Select effects and their start values by the search on the coarse copy; None to try all."""
        if self.coarse is None:
            return None
        ranked = self.coarse.screen(self.coarse.fitted(fit.solution.model, fit.solution.parameters))
        starts = {}
        for number, candidate in enumerate(ranked):
            effect, best = candidate.effect, candidate.search.best.parameters
            fine = self._fine_starts(fit, effect)
            if fine or number < SHORTLIST:
                starts[effect.name] = [own_parameters(effect, best), *fine]
        return starts

    def _fine_starts(self, fit: FitResult, effect: Effect) -> list[Inner]:
        """Return start values of a sensor effect that a coarse copy does not resolve: short or nonlinear."""
        if not isinstance(effect, SensorEffect):
            return []
        starts = effect.starts(fit.data)
        if not effect.linear:
            return list(starts)
        fine_s = _FINE * fit.problem.blocked.rows.shape[1] * sample_time(self.data.time_s, self.data.run)
        in_time = any(parameter.unit == "s" for parameter in effect.inner)
        return [start for start in starts if in_time and max(map(abs, start.values())) < fine_s]

    def refined(self, fitted: FitResult) -> FitResult:
        """Refit the effects of a model from start values that the coarse copy does not resolve.

        Args:
            fitted: the model from the search on the coarse copy, fitted to all data.
        """
        for name in self.added_effects(fitted):
            model, known = fitted.solution.model, fitted.solution.parameters
            effect = model.effect(name)
            tried = [
                solve_gains(fitted.problem, model, {**known, **{f"{name}.{n}": v for n, v in start.items()}})
                for start in self._fine_starts(fitted, effect)
            ]
            best = min(tried, key=lambda solution: solution.sse, default=fitted.solution)
            if best is not fitted.solution and best.sse < NEAR * fitted.solution.sse:
                fitted = self.refitted(model, best.parameters)
        return fitted

    def quick_screen(self, parent: FitResult) -> list[Candidate]:
        """Fit extensions of a model at few start values; return the possible ones, the best first.

        Args:
            parent: the model to extend.
        """
        return quick_screen(parent, applicable_effects(parent.data, parent.solution.model, self.effects))

    def alternatives(self, fit: FitResult, name: str) -> list[Candidate]:
        """Fit effects that replace an effect, including itself, at few start values; the best first.

        All other inner parameters are held fixed, since they would absorb the effect if refitted without it.

        Args:
            fit: the model.
            name: name of the effect to replace.
        """
        key = _key(fit.solution.model), name
        if key not in self._alternatives:
            model, known = fit.solution.model.without(name), fit.solution.parameters
            reduced = FitResult(fit.data, fit.problem, solve_gains(fit.problem, model, known))
            tried = applicable_effects(fit.data, model, self.effects)
            if self.coarse is not None:
                rough = self.coarse.alternatives(self.coarse.fitted(fit.solution.model, known), name)
                promising = {candidate.effect.name for candidate in rough[:SHORTLIST]} | {name}
                # The coarse copy does not resolve a short lag, which is the nearest rival of a short delay.
                kind = fit.solution.model.effect(name).kind
                promising |= {e.name for e in tried if e.kind is kind and self._fine_starts(fit, e)}
                tried = tuple(candidate for candidate in tried if candidate.name in promising)
            self._alternatives[key] = quick_screen(reduced, tried)
        return self._alternatives[key]

    def simpler_forms(self, fit: FitResult, name: str) -> list[Candidate]:
        """Fit effects of the same kind with fewer parameters in an effect's place, from all start values.

        A sharp optimum can lie between the few start values of `alternatives`.

        Args:
            fit: the model.
            name: name of the effect to replace.
        """
        model, effect = fit.solution.model.without(name), fit.solution.model.effect(name)
        reduced = FitResult(fit.data, fit.problem, solve_gains(fit.problem, model, fit.solution.parameters))
        tried = applicable_effects(fit.data, model, self.effects)
        simpler = [each for each in tried if parameter_count(each) < parameter_count(effect)]
        return screen_effects(reduced, [each for each in simpler if each.kind is effect.kind])

    def refit_effect(self, fit: FitResult, name: str) -> FitResult:
        """Refit an effect from its own start values, since other effects may have moved its optimum far away.

        Args:
            fit: the model.
            name: the effect.
        """
        model, known = fit.solution.model, fit.solution.parameters
        effect = model.effect(name)
        if not effect.inner or self.coarse is not None:
            return fit
        reduced = FitResult(fit.data, fit.problem, solve_gains(fit.problem, model.without(name), known))
        best = screen_effects(reduced, [effect])[0].search.best
        return self._fitted_from(best) if best.sse < (1.0 - TIE) * fit.solution.sse else fit

    def with_candidate(self, candidate: Candidate) -> FitResult:
        """Fit all parameters of a candidate's model jointly.

        Args:
            candidate: the effect with the model in which it was tried.
        """
        return self._fitted_from(candidate.search.best)

    def without(self, fit: FitResult, name: str) -> FitResult:
        """Fit the model without one of its effects.

        Args:
            fit: the model.
            name: the effect to drop.
        """
        return self._fitted_from(
            solve_gains(fit.problem, fit.solution.model.without(name), fit.solution.parameters)
        )

    def _fitted_from(self, solution: Solution) -> FitResult:
        """Fit the model of a solution; fit again if the solution is better than the fit from other starts."""
        fit = self.fitted(solution.model, solution.parameters)
        if solution.sse < (1.0 - TIE) * fit.solution.sse:
            return self.refitted(solution.model, solution.parameters)
        return fit

    def extensions(self, fit: FitResult) -> list[FitResult]:
        """Fit the most promising extensions of a model by one effect, in the order of `ordered`.

        An extension in which an earlier effect is implausible is returned with this effect replaced or
        dropped, if that is plausible.

        Args:
            fit: the model to extend.
        """
        count = FITTED if self.coarse is None else FITTED_IN_FULL
        # Sort the candidates by their error after the model's other parameters adapted to first order.
        possible = [candidate for candidate in self.screen(fit) if candidate.possible][:LOOKED_AT]
        follow = bool(fit.solution.model.inner)
        left = [
            candidate.error_with_adapted_inner(fit.problem) if follow else candidate.held_out
            for candidate in possible
        ]
        order = sorted(range(len(possible)), key=lambda number: left[number])
        limit = (1.0 - TIE) * fit.solution.held_out
        fits = [self.with_candidate(possible[i]) for i in [i for i in order if left[i] < limit][:count]]
        sensible = [extension for extension in fits if self.is_sensible(extension)]
        clearly_better = _MAX_LEFT * min(each.solution.held_out for each in (fit, *sensible))
        replaced = [
            self.replace_implausible(each) for each in fits if each.solution.held_out < clearly_better
        ]
        return self.ordered([*sensible, *filter(self.is_sensible, replaced)])

    def replace_implausible(self, fit: FitResult) -> FitResult:
        """Replace or drop added effects if one of them is implausible; see `backward_step`.

        An effect may have imitated one that was added later, and is implausible beside it.

        Args:
            fit: the model; returned itself if it is plausible.
        """
        return fit if self.is_sensible(fit) else backward_step(self, fit)

    def is_sensible(self, fit: FitResult) -> bool:
        """Check that each added effect is plausible and does not imitate another one, see `is_sound`.

        Args:
            fit: the model.
        """
        return all(self.is_sound(fit, name) for name in self.added_effects(fit))

    def is_sound(self, fit: FitResult, name: str) -> bool:
        """Check that an effect has possible parameters and does not imitate another effect.

        Args:
            fit: the model.
            name: the effect.
        """
        effect = fit.solution.model.effect(name)
        solution, problem = fit.solution, fit.problem
        if isinstance(effect, RunVariation):
            inner = own_parameters(effect, solution.parameters)
            reduced = solve_gains(problem, solution.model.without(name), solution.parameters)
            expected = reduced.model.predict(fit.data, reduced.parameters)
            if effect.is_common(expected, fit.data, inner) or effect.is_gradual(expected, fit.data, inner):
                return False
        return is_possible(effect, solution, problem) and not is_misnamed(effect, solution, problem)

    def substitutions(self, fit: FitResult, name: str) -> list[FitResult]:
        """Fit models that replace one effect and may be better, in the order of `ordered`.

        Args:
            fit: the model.
            name: name of the effect to replace.
        """
        tried = self.alternatives(fit, name)
        # The effect itself, also with few start values.
        own = [candidate.held_out for candidate in tried if candidate.effect.name == name]
        near = NEAR * max([fit.solution.held_out, *own])
        others = [
            candidate for candidate in tried if _key(candidate.search.best.model) != _key(fit.solution.model)
        ]
        fits = [self.with_candidate(candidate) for candidate in others[:2] if candidate.held_out < near]
        # A composite effect may also be replaced by its parts.
        effect = fit.solution.model.effect(name)
        present = {effect.name for effect in fit.solution.model.effects}
        parts = [part for part in self.effects if part.name in effect.parts and part.name not in present]
        fits += [self.with_each(self.without(fit, name), parts)] if parts else []
        return self.ordered([substitute for substitute in fits if self.is_sensible(substitute)])

    def with_each(self, fit: FitResult, effects: Sequence[Effect]) -> FitResult:
        """Add the effects that apply to the channel, one after the other.

        Args:
            fit: the model to extend.
            effects: the effects to add.
        """
        for effect in effects:
            if effect.applies_to(fit.data):
                (candidate,) = screen_effects(fit, [effect.suited_to(fit.data)])
                fit = self.with_candidate(candidate)
        return fit

    def is_better(self, fit: FitResult, reference: FitResult) -> bool:
        """Check whether a model leaves less error than another, or about as much with fewer parameters.

        Args:
            fit: the model.
            reference: the other model, fitted to the same data.
        """
        more = np.sign(self.size(fit) - self.size(reference))
        limit = (1.0 - SMALL) ** (2.0 * more) if more else 1.0 - TIE
        return bool(fit.solution.held_out < limit * reference.solution.held_out)

    def ordered(self, fits: Sequence[FitResult]) -> list[FitResult]:
        """Sort by held-out error; models about as good as the best are sorted by number of parameters.

        Args:
            fits: fitted models of the channel.
        """
        limit = (1.0 + TIE) * min((fit.solution.held_out for fit in fits), default=0.0)

        def rank(fit: FitResult) -> tuple[bool, int, float]:
            tied = fit.solution.held_out <= limit
            return not tied, self.size(fit) if tied else 0, fit.solution.held_out

        return sorted(fits, key=rank)

    def is_needed(self, before: FitResult, after: FitResult) -> bool:
        """Check whether an effect lowers the error by a relevant share and significantly.

        Args:
            before: the model without the effect, or before one effect replaced another.
            after: the model with the effect.
        """
        if after.rmse > (1.0 - SMALL) * before.rmse:
            return False
        if np.mean(after.solution.linear_fit.held_out < before.solution.linear_fit.held_out) < _FOLDS:
            return False
        if (before, after) not in self._significant:  # a backward step repeats the test of the last addition
            self._significant[before, after] = self.p_value(before, after, LEVEL) <= LEVEL
        return self._significant[before, after]

    def p_value(self, before: FitResult, after: FitResult, level: float = 1.0) -> float:
        """Estimate an effect's p-value by a max-statistic permutation test; 0 if it is clear without a test.

        Args:
            before: the model without the effect.
            after: the model with the effect.
            level: significance level; a p-value above it need not be exact.
        """
        used = after.problem.used
        noise = after.flexible.residual[used]
        observed = (before.solution.sse - after.solution.sse) / max(float(noise @ noise), 1e-300)
        if len(noise) > _MANY_BLOCKS and observed > max(_CLEAR * _MANY_BLOCKS / len(noise), _MIN_CLEAR):
            return 0.0
        tried = applicable_effects(before.data, before.solution.model, self.effects)
        columns = (columns[used] for effect in tried for columns in start_columns(before, effect))
        run, base = after.problem.blocked.run[used], before.solution.columns[used]
        most = int(level * (1 + COUNT)) - 1
        null = null_improvements(noise, run, base, columns, self.rng, observed=observed, most=most)
        return float((1 + np.sum(null >= observed)) / (1 + len(null)))


def prepare_search(  # noqa: PLR0917
    data: ChannelData,
    model: Model,
    good: BoolArray,
    effects: tuple[Effect, ...],
    rng: np.random.Generator,
    progress: Progress = lambda what, share: None,
) -> Search:
    """Prepare the search of a channel, with a coarse copy if blocks are longer than samples.

    Args:
        data: the channel.
        model: the base model.
        good: samples that a fit may use, shape (n,).
        effects: the library of candidate effects.
        rng: random generator for permutation and bootstrap tests.
        progress: callback that receives the current step and its completed share.
    """
    full_search = Search(data, model, good, effects, rng, progress)
    blocked = merge_blocks(full_search.start.problem.blocked, _MAX_BLOCKS)
    chosen = _select_runs(blocked)
    if blocked.rows.shape[1] == 1 and chosen.all():
        return full_search
    copy, good_copy = decimate(blocked).select(chosen), blocked.trusted[chosen]
    # Signals that were derived for the base model, such as its load, differ for other models.
    recorded = {name: copy.context[name] for name in data.context}
    copy = replace(copy, shared=data.shared, context=recorded)
    if not block_average(copy, good_copy).can_hold_out:
        return full_search
    return replace(full_search, coarse=Search(copy, model, good_copy, effects, rng, progress))


def _select_runs(blocked: BlockedData) -> BoolArray:
    """Return the mask (m,) of blocks for a coarse search, from enough runs with small and large efforts."""
    runs = [rows for rows in rows_of_runs(blocked.run) if blocked.trusted[rows].any()]
    stride = min(len(blocked) // _COARSE_BLOCKS, len(runs) // _COARSE_RUNS)
    if stride <= 1:
        return np.ones(len(blocked), dtype=np.bool_)
    by_effort = sorted(runs, key=lambda rows: float(np.ptp(blocked.effort[rows])))
    chosen = np.zeros(len(blocked), dtype=np.bool_)
    chosen[np.concatenate(by_effort[stride // 2 :: stride])] = True
    return chosen


def select_effects(
    whole: Search,
    is_complete: Callable[[FitResult], bool],
    sufficient: Callable[[FitResult], FitResult],
    forms: Callable[[], FitResult],
) -> FitResult:
    """Search for the model that explains most and in which each effect is needed.

    Effects are added one by one. If an explainable error remains, the best forms of all kinds are tried
    jointly. If more than half of the error is left even so, the best pair is tried too, since each of two
    effects alone may only distort the base model's parameters. It is also tried in place of more than two
    effects, or of two effects of one kind, which can imitate almost any error. A model of more than two is
    reduced to the smallest sufficient one.

    Args:
        whole: the search on all data.
        is_complete: function that tests whether a model leaves only noise.
        sufficient: function that reduces a model to the smallest sufficient one.
        forms: function that fits the best form of each kind that accounts for the error, on the coarse copy.
    """
    coarse = whole.coarse or whole

    @cache
    def refine(rough: FitResult) -> FitResult:
        """Fit a model of the coarse copy to all data, and continue there unless much error is left."""
        refined = whole.refined(whole.fitted(rough.solution.model, rough.solution.parameters))
        if whole.added_effects(refined) and refined.explainable_share() > _LITTLE:
            return refined
        return _forward_selection(whole, backward_step(whole, refined))

    def is_enough(fit: FitResult) -> bool:
        needs_nothing = not whole.added_effects(fit) or fit.rmse <= (1.0 + SMALL) * fit.floor()
        return (needs_nothing or fit.explainable_share() < _LITTLE) and is_complete(fit)

    best = refine(_forward_selection(coarse, coarse.start))
    if not is_enough(best):
        best = whole.ordered([best, refine(_forward_selection(coarse, backward_step(coarse, forms())))])[0]
    enough = is_enough(best)
    failed = not enough and best.solution.held_out > _MAX_LEFT * whole.start.solution.held_out
    names = whole.added_effects(best)
    kinds = {best.solution.model.effect(name).kind for name in names}
    may_imitate = enough and len(names) > min(len(kinds), _PAIR)
    if (failed or may_imitate) and (pair := _best_pair(coarse)):
        best = whole.ordered([best, refine(_forward_selection(coarse, pair))])[0]
    if enough and len(whole.added_effects(best)) > _PAIR:
        smaller = backward_step(whole, sufficient(best))
        best = smaller if is_enough(smaller) else best
    return best


def _best_pair(coarse: Search) -> FitResult | None:
    """Fit the best sensible pair of effects; a pair can succeed where neither effect does alone."""
    pairs = [
        (first, second)
        for first in coarse.screen(coarse.start)
        if first.possible
        for second in coarse.quick_screen(coarse.with_candidate(first))[:BESIDE]
    ]
    pairs.sort(key=lambda pair: pair[1].held_out)
    fits = (coarse.with_candidate(second) for _, second in pairs[:LOOKED_AT])
    return next(filter(coarse.is_sensible, fits), None)


def _forward_selection(search: Search, fit: FitResult) -> FitResult:
    """Add the best effect as long as one is needed, with a backward step after each addition.

    A selection that reaches a model of an earlier selection ends where that one ended.
    """
    passed = list[FitResult]()
    while fit not in search.selected and len(search.added_effects(fit)) < MOST_EFFECTS:
        passed.append(fit)
        needed = (extension for extension in search.extensions(fit) if search.is_needed(fit, extension))
        extension = next(needed, None)
        if extension is None:
            break
        reduced = backward_step(search, extension)
        if reduced.solution.held_out >= fit.solution.held_out:
            break
        fit = reduced
    end = search.selected.get(fit, fit)
    search.selected.update(dict.fromkeys(passed, end))
    return end


def backward_step(search: Search, fit: FitResult) -> FitResult:
    """Refit each added effect, drop it if it is not needed, and replace it if another effect is better.

    Args:
        search: the search of the channel.
        fit: the model with its effects.
    """
    for name in search.added_effects(fit):
        fit = search.refit_effect(fit, name)
        reduced = search.without(fit, name)
        if not search.is_needed(reduced, fit):
            fit = reduced
            continue
        is_sound = search.is_sound(fit, name)
        better = (
            substitute
            for substitute in search.substitutions(fit, name)
            if not is_sound or search.is_better(substitute, fit)
        )
        fit = next(better, fit if is_sound else reduced)
    return fit


def _key(model: Model) -> _Key:
    """Return a key that identifies a model; only the order of sensor effects matters."""
    sensors = tuple(effect.name for effect in model.effects if isinstance(effect, SensorEffect))
    return frozenset((effect.name, effect.form) for effect in model.effects), sensors
