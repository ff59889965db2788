"""Decide which effects of a model are accepted as findings, and which other effects fit as well.

If a model is complete (only noise is left), each effect that the model needs is accepted. In an incomplete
model, an effect is accepted if it explains most of the error that a flexible law of its kind explains. The
comparison includes flexible laws of the other kinds (`palpate.estimation.diagnosis.forms`).
"""

from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise
from statistics import NormalDist

import numpy as np

from palpate.estimation.budget import BudgetEntry
from palpate.estimation.budget.laws import GRAVITY_RANGE
from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.derivatives import grid_step
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.diagnosis.bootstrap import (
    SMOOTHING_TIMES,
    encoder_step_error,
    improvement_test,
    smoothing_error,
)
from palpate.estimation.diagnosis.candidates import (
    Candidate,
    cross_validated_error,
    determined_count,
    parameter_count,
)
from palpate.estimation.diagnosis.forms import (
    AS_GOOD,
    AS_MUCH,
    MOST_OF_LAW,
    SLOW,
    FormTest,
    PartiallyLinear,
    form_tests,
    imitating_effect,
)
from palpate.estimation.diagnosis.search import LEVEL, NEAR, TIE, Search, backward_step
from palpate.estimation.effect import Effect
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_model import MeasurementModel, identify_measurement_model
from palpate.estimation.fit.measurement_noise import measurement_noise
from palpate.estimation.fit.smoothing_bias import (
    is_below_cutoff,
    is_in_smoothed_effort,
    looks_like_smoothing,
)
from palpate.estimation.kinds import PHYSICAL_KINDS, SENSOR_KINDS, Kind
from palpate.estimation.signals.motion import is_stepwise_command
from palpate.robot_io.types import FloatArray

CompletenessTest = Callable[[FitResult], bool]
_MAX_RIVALS = 5  # most alternatives tested per effect; each must explain at least half as much
# Least gain of a flexible regression, as a share of the squared error that the effects explain. No law is
# exact, so a smaller gain is ignored.
_MIN_GAIN = 0.01
# Ratio of the interval at `LEVEL` to the 95 % interval.
_INTERVAL_RATIO = NormalDist().inv_cdf(1.0 - 0.5 * LEVEL) / NormalDist().inv_cdf(0.975)
_MIN_SHARE = 0.02  # least share of the error that a kind must account for
MIN_OF_UNEXPLAINED = 0.25  # least mean square of an effect, relative to the unexplained one
_MAX_UNEXPLAINED = 0.1  # unexplained mean square, relative to an effect's, above which another may explain it
_FAULT_KINDS = SENSOR_KINDS | {Kind.DRIFT}  # named only if their size is certain
_OFFSET = "bias"  # name of the effect that is a constant
_NEARLY_ALL = 0.99  # least share of the error above the noise that a sensor fault or a drift must explain
_SAME_CURVE = 1e-3  # energy of the difference of two curves, relative to what the effect adds


def is_outperformed(base: FitResult, fit: FitResult) -> bool:
    """Return whether the base model beats a model with effects, if both have a flexible regression.

    No law of a real object is exact, so gains below a small share of what the effects explain are ignored.

    Args:
        base: the fitted base model.
        fit: the fitted model with effects.
    """

    def mean_square(squared_errors: FloatArray, result: FitResult) -> float:
        return float(squared_errors.sum()) / max(int(result.problem.used.sum()), 1)

    before, after = (mean_square(result.flexible.before, result) for result in (base, fit))
    flexible_before, flexible_after = (
        mean_square(result.flexible.held_out, result) for result in (base, fit)
    )
    gain = flexible_after - flexible_before
    return flexible_before < AS_GOOD * flexible_after and gain > _MIN_GAIN * (before - after)


def accept_effects(
    search: Search, fit: FitResult, measurement: MeasurementModel, is_complete: CompletenessTest
) -> FitResult:
    """Reduce a complete model to the effects that it needs, or to the base model if it needs none.

    Args:
        search: the search that led to the model.
        fit: base model and effects; only noise is left.
        measurement: how motion and effort were measured.
        is_complete: whether a model counts as complete.
    """
    # Bootstrap samples contain smoothing errors, too. Beside an effect that explains these, no other effect
    # seems significant.
    for name in reversed(_effects_by_importance(search, fit)):
        reduced = search.without(fit, name)
        if is_smoothing(reduced, fit) and search.is_sensible(reduced):
            fit = reduced
    if not search.added_effects(fit) or not search.is_sensible(fit):
        return search.start
    sufficient = smallest_sufficient_model(search, fit, measurement)
    is_reducible = sufficient is not fit
    reduced = sufficient if is_reducible else _drop_needless_effects(search, fit, measurement, is_complete)
    if reduced is fit or reduced is search.start:
        return reduced
    return accept_effects(search, backward_step(search, reduced), measurement, is_complete)


def accept_forms(
    search: Search,
    partial: PartiallyLinear,
    fit: FitResult,
    measurement: MeasurementModel,
    fewest: int = 1,
) -> tuple[FitResult, list[FormTest]]:
    """Reduce an incomplete model to the effects whose form is known, exactly or approximately.

    Effects that fail the form test are dropped one by one, the least important first. An effect is replaced
    by another form of its kind with no more parameters if that form fits better.

    Args:
        search: the search that led to the model.
        partial: flexible laws of the kinds that account for the error, on the same blocks.
        fit: base model and effects.
        measurement: how motion and effort were measured.
        fewest: number of effects below which the result would not be used.

    Returns:
        The reduced model and a form test of each effect. The base model and no tests are returned if fewer
        than `fewest` forms are known, or if the effects improve bootstrap samples of the base model as much
        as the data.
    """
    added = map(fit.solution.model.effect, search.added_effects(fit))
    kinds = frozenset(effect.kind for effect in added) - {Kind.RUN_DIFFERENCES}
    while len(search.added_effects(fit)) >= fewest:
        form_criteria = FormCriteria(search, partial, fit, kinds)
        tests = sorted(form_criteria.tests, key=lambda test: test.explained_by_effect)
        failing = (test.effect for test in tests if form_criteria.failed_by(test))
        if len(tests) == fewest and any(failing):
            break
        if failed := list(failing):
            fit = search.without(fit, min(failed, key=form_criteria.explained))
            continue
        alternatives = [form for test in tests for form in similar_forms(search, fit, test.effect).values()]
        better = [form for form in alternatives if search.is_sensible(form) and search.is_better(form, fit)]
        better = better or [
            alternative
            for test in tests
            for alternative in _physical_alternatives(search, fit, test.effect)
            if search.is_sensible(alternative)
        ]
        if not better:
            if not improvement_test(search.start, fit, measurement, search.rng).is_significant:
                break
            return _with_weight(search, partial, fit, measurement) or (fit, form_criteria.tests)
        fit = min(better, key=lambda alternative: alternative.solution.held_out)
    return search.start, []


class FormCriteria:
    """Criteria that each effect of an incomplete model must meet to be accepted."""

    def __init__(
        self, search: Search, partial: PartiallyLinear, fit: FitResult, kinds: frozenset[Kind] = frozenset()
    ) -> None:
        """Test the form of each effect.

        Args:
            search: the search that led to the model.
            partial: flexible laws of the kinds that account for the error, on the same blocks.
            fit: base model and effects.
            kinds: additional kinds whose laws are included in the form tests.
        """
        self._search, self._partial, self._fit = search, partial, fit
        self.tests = form_tests(partial, fit, kinds)
        self._count = max(int(fit.problem.used.sum()), 1)
        self._left = cross_validated_error(fit.problem, fit.solution) / self._count
        self.explained = cache(self._explained)
        effects = [fit.solution.model.effect(test.effect) for test in self.tests]
        budget = partial.budget_with(frozenset(map(partial.kind_of, effects)))
        self._entries = {entry.kind: entry for entry in budget.entries}
        noise = measurement_noise(search.start).value
        self._unexplained = max(fit.rmse**2 - noise**2, 0.0)  # mean square above the noise [effort^2]
        # Whether the effects jointly leave as little error as the laws of all relevant kinds, and little of
        # the total error.
        share_left = self._left / partial.budget.base**2
        self._is_as_good = share_left <= min(partial.budget.unexplained / AS_GOOD, 1.0 - MOST_OF_LAW)
        # An effect that explains less than a flexible regression of the residual may imitate the residual.
        base, flexible = search.start.held_out_mean_square, fit.flexible.explained / self._count
        self._least = max(SMALL * base, flexible, MIN_OF_UNEXPLAINED * self._unexplained)
        # A clear effect is larger than the noise, or than a small share of the base model's error.
        self._smallest = min(noise**2, SMALL * base)
        self._unnamed = max(self._unexplained, flexible)

    def _explained(self, name: str) -> float:
        """Return the mean square that an effect removes [effort^2]."""
        reduced = self._search.without(self._fit, name)
        return cross_validated_error(reduced.problem, reduced.solution) / self._count - self._left

    def failed_by(self, test: FormTest) -> str:
        """Return the first criterion that an effect does not meet, as a clause; empty if it meets all.

        Args:
            test: the form test of the effect, one of `tests`.
        """
        if impossible := self._impossible(test):
            return impossible
        may_be_zero = test.kind in _FAULT_KINDS and _has_zero_size(
            self._search.without(self._fit, test.effect), self._fit, test.effect
        )
        if self._is_clear(test) and not may_be_zero:
            return ""
        size = self.explained(test.effect)
        if size < self._least:
            return "it explains too little compared with the error that remains"
        # Two forms of one kind can imitate almost any third form.
        kind_of = {effect.name: effect.kind for effect in self._fit.solution.model.effects}
        rivals = [other.effect for other in self.tests if kind_of[other.effect] is kind_of[test.effect]]
        if any(self.explained(rival) > size for rival in rivals):
            return "another effect of the same kind explains more"
        if may_be_zero:
            return "the interval of its size contains zero"
        return "" if self._accounts_for_error(test) else "other kinds of effects explain most of this error"

    def _impossible(self, test: FormTest) -> str:
        """State why an effect cannot be accepted, whatever it explains; empty if it can."""
        if not (test.is_known or self._is_as_good):
            percent = int(100.0 * max(test.share, 0.0))  # 79.9 % is not the 80 % that is required
            law = f"a flexible law of {test.kind.word}"
            return f"its form explains only {percent} % of the error that {law} explains"
        if not self._search.is_sound(self._fit, test.effect):
            return "its fitted parameters are physically impossible or contradict its name"
        if is_smoothing(self._search.without(self._fit, test.effect), self._fit):
            return "the smoothing of the derived acceleration may cause the same error"
        return ""

    def _is_clear(self, test: FormTest) -> bool:
        """Return whether an effect explains most of the error above the noise that is left without it."""
        # Then no other effect can explain this error in its place. Faults of the sensor and drifts are rare,
        # and therefore need more evidence.
        size = self.explained(test.effect)
        most = MOST_OF_LAW if test.kind in PHYSICAL_KINDS else _NEARLY_ALL
        return (
            self._is_as_good
            and size >= max(most * (size + self._unnamed), self._smallest)
            and self._search.is_needed(self._search.without(self._fit, test.effect), self._fit)
        )

    def _accounts_for_error(self, test: FormTest) -> bool:
        """Return whether an effect's kind accounts for an error that no other kind explains in its place."""
        fit, partial, base = self._fit, self._partial, self._search.start
        effect, explained = fit.solution.model.effect(test.effect), self.explained(test.effect)
        entries = [self._entries[kind] for kind in effect.also | {test.kind} if kind in self._entries]
        if not entries:
            return True  # kinds without a flexible law
        entry = max(entries, key=lambda entry: entry.share)
        # If another kind can replace this kind, the effect must be distinguishable from it: nearly nothing
        # remains unexplained, or the effect with its few parameters fits as well as the other kind's law.
        replacing = [partial.kinds - {entry.kind} | {kind} for kind in entry.replaceable_by]
        left_by_replacement = min(map(partial.error.mean_square, replacing), default=-np.inf)
        is_distinct = not entry.replaceable_by or self._unexplained < _MAX_UNEXPLAINED * explained
        is_distinct |= AS_GOOD * test.unexplained_by_all <= left_by_replacement
        # Needless laws outside the smallest sufficient set also have shares. These count only if kind and
        # effect explain as much in the place of a member.
        is_replacement = any(explained >= least for least in self._replacement_thresholds(entry))
        is_counted = (entry.kind in partial.kinds or is_replacement) and is_distinct
        if entry.necessary >= _MIN_SHARE or (entry.share >= _MIN_SHARE and is_counted):
            return True
        by_laws = partial.budget.unexplained_by_all * base.held_out_mean_square
        alone = self._search.fitted(base.solution.model.with_effect(effect), fit.solution.parameters)
        if alone.held_out_mean_square < by_laws:
            return True
        # The predictions of laws are added, so they cannot explain a product of two effects.
        is_better = fit.held_out_mean_square < AS_GOOD * by_laws
        without = self._search.without(fit, test.effect)
        if test.kind in PHYSICAL_KINDS and is_better and without.held_out_mean_square > by_laws:
            return True
        return self._completes_form(effect, without)

    def _completes_form(self, effect: Effect, without: FitResult) -> bool:
        """Return whether the other parts of a composite effect have no known form without an effect."""
        # The law of the composite effect's kind explains the error of each part.
        composites = [
            c for c in self._search.effects if c.kind in self._partial.kinds and effect.name in c.parts
        ]
        parts = {part for composite in composites for part in composite.parts}
        tests = form_tests(self._partial, without) if parts else []
        return any(test.effect in parts and not test.is_known for test in tests)

    def _replacement_thresholds(self, entry: BudgetEntry) -> Iterator[float]:
        """Yield the mean square that an effect must explain to replace each kind: most of that of its law."""
        order, partial = list(Kind), self._partial
        left = partial.error.mean_square(partial.kinds)
        for replaced in partial.budget.entries:
            if entry.kind in partial.replacements(replaced):
                by_law = partial.error.mean_square(partial.kinds - {replaced.kind}) - left
                is_likelier = order.index(entry.kind) < order.index(replaced.kind)
                yield (MOST_OF_LAW if is_likelier else AS_MUCH) * by_law


def smallest_sufficient_model(search: Search, fit: FitResult, measurement: MeasurementModel) -> FitResult:
    """Find the smallest nested model that the full model does not improve significantly.

    Nested models add the effects in order of importance. Some effects are significant only jointly.

    Args:
        search: the search of the channel.
        fit: the full model.
        measurement: how motion and effort were measured.
    """
    for nested in (search.start, *models_by_importance(search, fit)[:-1]):
        if not improvement_test(nested, fit, measurement, search.rng).is_significant:
            return nested
    return fit


def _drop_needless_effects(
    search: Search, fit: FitResult, measurement: MeasurementModel, is_complete: CompletenessTest
) -> FitResult:
    """Drop each effect that is small, indistinguishable from rounding, or not significant."""
    # An effect is not small, however large the others are, if it exceeds the noise or completes the model.
    for name in reversed(_effects_by_importance(search, fit)):
        reduced = search.without(fit, name)
        explained = np.sqrt(max(reduced.held_out_mean_square - fit.held_out_mean_square, 0.0))
        is_small = (
            reduced.rmse - fit.rmse < SMALL * (search.start.rmse - fit.rmse)
            and explained <= measurement_noise(search.start).value
            and is_complete(reduced)
        )
        # If the model needs the effect, a wide interval only shows that parameters are collinear.
        may_be_zero = _has_zero_size(reduced, fit, name) and is_complete(reduced)
        is_needless = is_small or _is_rounding(search, fit, name) or may_be_zero
        is_needless |= bool(explained <= encoder_step_error(reduced, measurement))
        is_needless = is_needless or is_smoothing(reduced, fit)
        is_needed = not is_needless and search.is_needed(reduced, fit)
        if is_needed and improvement_test(reduced, fit, measurement, search.rng, name).is_significant:
            continue
        if search.is_sensible(reduced):  # otherwise another effect imitates the dropped one
            fit = reduced
    return fit


def _effects_by_importance(search: Search, fit: FitResult) -> list[str]:
    """List the added effects of a model, the most important first."""
    path = [search.start, *models_by_importance(search, fit)]
    return [
        name
        for before, after in pairwise(path)
        for name in set(search.added_effects(after)) - set(search.added_effects(before))
    ]


def models_by_importance(search: Search, fit: FitResult) -> list[FitResult]:
    """List the nested models from one effect to the full model in the order of backward elimination.

    Each step drops the effect whose removal increases the error least.

    Args:
        search: the search of the channel.
        fit: the full model, the last one of the list.
    """
    path = [fit]
    while search.added_effects(path[0]):
        reduced = [search.without(path[0], name) for name in search.added_effects(path[0])]
        path.insert(0, min(reduced, key=lambda model: model.solution.held_out))
    return path[1:]


def indistinguishable_models(
    search: Search, fit: FitResult, name: str, measurement: MeasurementModel
) -> dict[str, FitResult]:
    """Fit models, by name of a replacing effect, that the data do not reject in place of the accepted model.

    Single alternatives come first, the best first, followed by composite effects that also replace other
    effects of the model: friction that differs by direction is Coulomb friction and a bias.

    Args:
        search: the search of the channel.
        fit: the accepted model.
        name: the effect that is replaced.
        measurement: how motion and effort were measured.
    """
    models = {
        candidate.effect.name: search.with_candidate(candidate)
        for candidate in _rivals(search, fit, name, measurement)
    }
    for part, model in [(name, fit), *models.items()]:
        for composite, replaced in _composites(search, model, part):
            if not improvement_test(replaced, fit, measurement, search.rng).is_significant:
                models[composite] = replaced
    return models


def _composites(search: Search, fit: FitResult, name: str) -> Iterator[tuple[str, FitResult]]:
    """Yield composite effects, with the model in which each replaces an effect and others of the model."""
    present = {effect.name for effect in fit.solution.model.effects}
    for effect in search.effects:
        is_new = name in effect.parts and effect.name not in present and present >= set(effect.parts)
        if is_new and effect.applies_to(fit.data):
            reduced = fit
            for part in search.added_effects(fit):
                reduced = search.without(reduced, part) if part in effect.parts else reduced
            yield effect.name, search.with_each(reduced, [effect])


def similar_forms(search: Search, fit: FitResult, name: str) -> dict[str, FitResult]:
    """Fit models, by name, with another effect of the kind that explains as much with no more parameters.

    Args:
        search: the search of the channel.
        fit: the accepted model.
        name: the effect that is replaced.
    """
    kind, (limit, alternatives) = fit.solution.model.effect(name).kind, _alternatives(search, fit, name)
    return {
        candidate.effect.name: search.with_candidate(candidate)
        for candidate in alternatives
        if candidate.effect.kind is kind and candidate.held_out <= limit
    }


def as_good_effects(search: Search, fit: FitResult, name: str) -> dict[str, FitResult]:
    """Fit models, by name, with an effect of another kind that explains as much with no more parameters.

    Only parameters that the data determine count. If a joint never reverses, its friction looks like a bias;
    over a short range, a weight looks like a spring. A replacement's squared error is at most 1 / `AS_GOOD`
    times the model's.

    Args:
        search: the search of the channel.
        fit: the accepted model.
        name: the effect that is replaced.
    """
    effect = fit.solution.model.effect(name)
    max_count = determined_count(effect, fit.solution, fit.problem)
    as_much, alternatives = _alternatives(search, fit, name, max_count)
    limit = min(as_much, fit.solution.held_out / AS_GOOD)
    models = {
        candidate.effect.name: search.with_candidate(candidate)
        for candidate in alternatives
        if candidate.effect.kind is not effect.kind and candidate.held_out <= limit
    }
    return {other: model for other, model in models.items() if search.is_sensible(model)}


def _physical_alternatives(search: Search, fit: FitResult, name: str) -> Iterator[FitResult]:
    """Fit models in which an effect of the object or the drive, which is likelier, replaces a sensor's."""
    if fit.solution.model.effect(name).kind not in SENSOR_KINDS:
        return
    limit, alternatives = _alternatives(search, fit, name)
    physical = [candidate for candidate in alternatives if candidate.effect.kind in PHYSICAL_KINDS]
    yield from (model for model in map(search.with_candidate, physical) if model.solution.held_out <= limit)


def _with_weight(
    search: Search, partial: PartiallyLinear, fit: FitResult, measurement: MeasurementModel
) -> tuple[FitResult, list[FormTest]] | None:
    """Replace a joint's spring or bias with its weight if the accepted effects then explain as much."""
    # The spring or bias is kept if the model with it leaves only noise, and the model with the weight more.
    base, only_noise = search.start.solution.held_out, SLOW * measurement_noise(search.start).value
    for name in search.added_effects(fit):
        for candidate in _alternatives(search, fit, name, np.inf)[1]:
            if not _is_missing_weight(search, candidate.effect, fit.solution.model.effect(name)):
                continue
            end, tests = accept_forms(search, partial, search.with_candidate(candidate), measurement)
            explained, needed = base - end.solution.held_out, base - fit.solution.held_out
            explains_as_much = explained >= (needed if name == _OFFSET else AS_MUCH * needed)
            leaves_more = fit.rmse <= only_noise < end.rmse
            if candidate.effect.name in search.added_effects(end) and explains_as_much and not leaves_more:
                return end, tests
    return None


def _is_missing_weight(search: Search, candidate: Effect, effect: Effect) -> bool:
    """Return whether a candidate is a joint's weight, which the base model lacks and the effect resembles."""
    # Gravity acts on a joint unless its axis is vertical, but springs and biases are rare. The joint must
    # turn enough to tell a weight from a constant.
    return (
        candidate.kind is Kind.GRAVITY_LOAD
        and effect.name in candidate.confused_with
        and all(effect.kind is not Kind.GRAVITY_LOAD for effect in search.model.effects)
        and search.data.range_of_motion > GRAVITY_RANGE
    )


def _alternatives(
    search: Search, fit: FitResult, name: str, max_count: float | None = None
) -> tuple[float, list[Candidate]]:
    """Return the largest held-out error equivalent to `fit`, and alternatives with few parameters."""
    without = search.without(fit, name).solution.held_out
    max_count = parameter_count(fit.solution.model.effect(name)) if max_count is None else max_count
    return without - AS_MUCH * (without - fit.solution.held_out), [
        candidate
        for candidate in search.alternatives(fit, name)
        if candidate.effect.name != name and _has_at_most(max_count, candidate, fit)
    ]


def _has_at_most(max_count: float, candidate: Candidate, fit: FitResult) -> bool:
    """Return whether the data determine at most `max_count` parameters of a candidate."""
    if parameter_count(candidate.effect) <= max_count:
        return True
    if len(candidate.effect.gains) > max_count:
        return False
    return determined_count(candidate.effect, candidate.search.best, fit.problem) <= max_count


def most_parsimonious(
    search: Search, fit: FitResult, measurement: MeasurementModel, is_complete: CompletenessTest
) -> FitResult:
    """Replace each effect with an indistinguishable one with fewer parameters, or as many and a better fit.

    Of indistinguishable laws the simplest is preferred if the model remains complete (W. H. Jefferys, J. O.
    Berger, American Scientist 80 (1992)). An effect of the object or the drive is preferred to a sensor
    effect, and the weight of a joint to a spring.

    Args:
        search: the search that led to the model.
        fit: base model and accepted effects.
        measurement: how motion and effort were measured.
        is_complete: whether a model leaves only noise.
    """
    for name in _effects_by_importance(search, fit):
        effect = fit.solution.model.effect(name)
        max_count = parameter_count(effect)
        own = [fit.parameters[f"{name}.{parameter.name}"] for parameter in (*effect.gains, *effect.inner)]
        # A parameter is undetermined if its interval contains zero or is unknown.
        if any(not abs(e.value) > 0.5 * np.ptp(e.interval) for e in own if not e.at_bound):
            near = [
                candidate
                for candidate in search.alternatives(fit, name)[:_MAX_RIVALS]
                if parameter_count(candidate.effect) < max_count
                and candidate.error_with_adapted_inner(fit.problem) <= NEAR * fit.solution.held_out
            ]
            simpler = [search.with_candidate(each) for each in (*near, *search.simpler_forms(fit, name))]
            limit = (1.0 + SMALL) * fit.rmse
            simpler = [model for model in simpler if model.rmse <= limit and search.is_sensible(model)]
            if simpler:
                fit = min(simpler, key=lambda model: (search.size(model), model.solution.held_out))
                continue
        candidates = [
            candidate
            for candidate in _rivals(search, fit, name, measurement, max_count)
            if effect.kind not in PHYSICAL_KINDS or candidate.effect.kind not in SENSOR_KINDS
        ]
        likelier = [
            search.with_candidate(candidate)
            for candidate in candidates
            if (
                _is_missing_weight(search, candidate.effect, effect)
                and not (name == _OFFSET and candidate.held_out > fit.solution.held_out)
            )
            or (effect.kind in SENSOR_KINDS and candidate.effect.kind in PHYSICAL_KINDS)
        ]
        rivals = map(search.with_candidate, candidates)
        better = likelier or [rival for rival in rivals if search.is_better(rival, fit)]
        better = [rival for rival in better if is_complete(rival) >= is_complete(fit)]
        better.sort(key=lambda model: (search.size(model), model.solution.held_out))
        kept = search.added_effects(fit)
        for rival in better:
            # An effect that is likelier or simpler may still imitate the one that it would replace.
            new = [added for added in search.added_effects(rival) if added not in kept]
            if imitating_effect(search, rival, new) is None:
                fit = rival
                break
    return fit


def _rivals(
    search: Search, fit: FitResult, name: str, measurement: MeasurementModel, max_count: float = np.inf
) -> Iterator[Candidate]:
    """Yield candidates with at most `max_count` parameters that may replace an effect without rejection."""
    # A missing weight may have more parameters.
    effect, without = fit.solution.model.effect(name), search.without(fit, name)
    half = 0.5 * (without.solution.held_out + fit.solution.held_out)
    # Few start values may all miss the best inner parameters, so order the alternatives by adapted ones.
    adapted = [
        (candidate.error_with_adapted_inner(fit.problem), candidate)
        for candidate in search.alternatives(fit, name)
        if candidate.effect.name != name
        and (_is_missing_weight(search, candidate.effect, effect) or _has_at_most(max_count, candidate, fit))
    ]
    for error, candidate in sorted(adapted, key=lambda pair: pair[0])[:_MAX_RIVALS]:
        if error > NEAR * half:
            continue
        rival = search.with_candidate(candidate)
        if not search.is_sensible(rival):
            continue
        # A law with further terms that describes the same curve is no rival, since the data set them to zero.
        # One additional parameter may be a position or a phase.
        is_larger = search.size(rival) > search.size(fit) + 1
        if rival.solution.held_out > half or (is_larger and _is_same_curve(rival, fit, without)):
            continue
        is_rival = _fits_as_well_unsmoothed(search, rival, fit)
        if is_rival or not improvement_test(rival, fit, measurement, search.rng).is_significant:
            yield candidate


def _fits_as_well_unsmoothed(search: Search, rival: FitResult, fit: FitResult) -> bool:
    """Return whether a rival with no more parameters fits as well if smoothing of the motion counts as noise.

    A lag smooths the effort that is computed from a derived acceleration a second time, so a delay fits
    better in place of a lag that is shorter than the derivative filter. Bootstrap samples do not show this,
    since their true motion is the smoothed one.
    """
    is_derived = fit.filters != ((), ()) and fit.data.kind is not ChannelKind.CONTACT
    if not is_derived or search.size(rival) > search.size(fit):
        return False
    return bool(rival.flexible.before.sum() <= (1.0 + TIE) * fit.flexible.before.sum())


def _is_same_curve(rival: FitResult, fit: FitResult, without: FitResult) -> bool:
    """Return whether two models predict the same, except for a small share of the effect's contribution."""
    residuals = [result.solution.residual for result in (rival, fit, without)]
    if len(set(map(len, residuals))) > 1:  # the models use different samples in contact
        return False
    difference, added = residuals[0] - residuals[1], residuals[2] - residuals[1]
    return float(difference @ difference) < _SAME_CURVE * float(added @ added)


def _has_zero_size(reduced: FitResult, fit: FitResult, name: str) -> bool:
    """Return whether the intervals at `LEVEL` of all parameters that scale an effect contain zero."""
    # The parameters are the gains, or the first inner parameter of an effect without gains (a gap, a time).
    # Wide intervals of a large effect of the object or the drive only show that parameters are collinear.
    effect = fit.solution.model.effect(name)
    # An infinite interval only shows that the prediction does not change near the fitted value, as that of a
    # delay between two steps.
    is_large = fit.flexible.before.sum() <= 0.5 * reduced.flexible.before.sum()
    if is_large and effect.kind not in _FAULT_KINDS:
        return False
    sizes = [fit.parameters[f"{name}.{parameter.name}"] for parameter in effect.gains or effect.inner[:1]]
    if is_large and not any(np.isfinite(np.ptp(size.interval)) for size in sizes):
        return False
    return not any(abs(size.value) > 0.5 * _INTERVAL_RATIO * np.ptp(size.interval) for size in sizes)


def is_smoothing(reduced: FitResult, fit: FitResult) -> bool:
    """Return whether effects of a joint explain mostly what the smoothing of its motion may cause.

    Args:
        reduced: the model without the effects.
        fit: the model with them.
    """
    if fit.filters == ((), ()) or fit.data.kind is ChannelKind.CONTACT:
        return False
    before, after, problem = reduced.solution.residual, fit.solution.residual, reduced.problem
    if not is_below_cutoff(problem, before, after, fit.filters):
        fall = float(np.mean(before[problem.used] ** 2) - np.mean(after[problem.used] ** 2))
        error = smoothing_error(reduced, identify_measurement_model(reduced.training))
        if fall <= (SMOOTHING_TIMES * error) ** 2:
            return True
    change = before - after
    if looks_like_smoothing(problem, problem.blocked.effort - before, change, fit.filters):
        return True
    # An elasticity is fitted too large beside a smoothed motion, but a fault of the sensor is rarer.
    kept = {effect.name for effect in reduced.model.effects}
    is_fault = all(effect.kind in SENSOR_KINDS for effect in fit.model.effects if effect.name not in kept)
    return is_fault and not is_in_smoothed_effort(problem, reduced.solution, change, fit.filters)


def _is_rounding(search: Search, fit: FitResult, name: str) -> bool:
    """Return whether an effect explains no more than the quantization of the measured effort."""
    if name == "quantisation" or is_stepwise_command(fit.data):
        return False
    step, reduced = grid_step(np.sort(fit.data.effort)), search.without(fit, name)
    added = np.sqrt(max(reduced.rmse**2 - fit.rmse**2, 0.0))
    return bool(step > 0.0 and added < step / np.sqrt(12.0) and fit.rmse < step)
