"""Which effects of a model may be called by their names.

Effects of a complete model are accepted where each is needed. Those of an incomplete model are accepted
where each takes most of what a flexible law of its kind takes, beside flexible laws of the other kinds
(`palpate.estimation.diagnosis.forms`).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist

import numpy as np

from palpate.estimation.budget import BudgetEntry
from palpate.estimation.data.derivatives import grid_step
from palpate.estimation.diagnosis.bootstrap import SMALL, encoder_step_error, improvement_test
from palpate.estimation.diagnosis.candidates import Candidate, held_out_of_all, parameter_count
from palpate.estimation.diagnosis.forms import AS_MUCH, MOST_OF_LAW, FormTest, PartiallyLinear, form_tests
from palpate.estimation.diagnosis.search import LEVEL, NEAR, Search, backward_step
from palpate.estimation.effect import Effect
from palpate.estimation.fit.fit_result import FitResult, final_solution
from palpate.estimation.fit.intervals import estimate_parameters
from palpate.estimation.fit.measurement_model import MeasurementModel
from palpate.estimation.fit.measurement_noise import measurement_noise
from palpate.estimation.kinds import Kind

AS_GOOD = 0.9  # of the squared error that names leave, that a law without a name must not get below
Complete = Callable[[FitResult], bool]
_RIVALS = 5  # looked at in the place of an effect; each must explain half of what that does
_SMALL_SHARE = 0.01  # of the squared error that an effect takes away: no law of a real thing is exact
_SURE = NormalDist().inv_cdf(1.0 - 0.5 * LEVEL) / NormalDist().inv_cdf(0.975)  # interval at `LEVEL` / 95 %
_LEAST_OF_KIND = 0.02  # of the error, for which a kind must account beside the others
_OF_UNEXPLAINED = 0.25  # of what nothing explains, beside which less may be a part of that
_UNDECIDED = 0.1  # of what an effect takes: more that nothing explains may belong to another kind
_RUNS = 5  # of which fewer do not say how runs vary, where something else is left too
_OF_READER = frozenset({Kind.SENSOR_STATICS, Kind.SENSOR_DYNAMICS})
_WITHIN = 1e-3  # of the energy of what an effect adds, by which curves that are the same may differ


@dataclass(frozen=True)
class AcceptanceCriteria:
    """What a model is held against, as mean squares of the error on blocks of held-out runs."""

    base: float  # of the base model
    named: float  # of the model with effects
    nameless: float  # of the base model and a smooth law of all signals
    both: float  # of the model with effects and such a law

    @property
    def is_outperformed(self) -> bool:
        """Whether a law without a name does better beside the base model than beside the names.

        By less than a small share of what the names take away says nothing: no law of a real thing is exact.
        """
        by = self.both - self.nameless
        return self.nameless < AS_GOOD * self.both and by > _SMALL_SHARE * (self.base - self.named)


def acceptance_criteria(start: FitResult, end: FitResult) -> AcceptanceCriteria:
    """How well effects and nameless laws describe runs that were held out.

    Args:
        start: the base model.
        end: the model that the search ended with.
    """
    counts = [max(int(one.problem.used.sum()), 1) for one in (start, end)]
    one, other = start.flexible, end.flexible
    left = (one.before, other.before, one.held_out, other.held_out)
    return AcceptanceCriteria(
        *(float(held_out.sum()) / count for held_out, count in zip(left, counts * 2, strict=True))
    )


def accept_effects(search: Search, end: FitResult, measurement: MeasurementModel) -> FitResult:
    """Reduce a complete model to the effects that it needs; the base model where it needs none.

    Args:
        search: that led to the model.
        end: base model and effects, which leave no more than draws from them do.
        measurement: how the motion was read.
    """
    if not search.added_effects(end) or not search.is_sensible(end):
        return search.start
    some = smallest_sufficient_model(search, end, measurement)
    less = _without_needless(search, end, measurement) if some is end else some
    if less is end or less is search.start:
        return less
    return accept_effects(search, backward_step(search, less), measurement)


def accept_forms(
    search: Search, partial: PartiallyLinear, end: FitResult, measurement: MeasurementModel
) -> tuple[FitResult, list[FormTest]]:
    """Reduce an incomplete model to the effects whose form is known, exactly or approximately.

    Of forms of one kind with as few parameters, the one that leaves least is taken.

    Args:
        search: that led to the model.
        partial: the kinds that account for the error, on the same blocks.
        end: base model and effects.
        measurement: how the motion was read.

    Returns:
        The model with these effects, and the comparison of each with its kind's law; the base model and no
        comparison where none has a known form, or draws from the base model gain as much by them.
    """
    base = {effect.name for effect in search.model.effects}
    kinds = frozenset(effect.kind for effect in end.solution.model.effects if effect.name not in base)
    noise = measurement_noise(search.start).value
    while search.added_effects(end):
        tests = form_tests(partial, end, kinds - {Kind.RUN_DIFFERENCES})
        left = held_out_of_all(end.problem, end.solution)
        count = max(int(end.problem.used.sum()), 1)
        taken = {}
        for test in tests:
            less = search.without(end, test.effect)
            taken[test.effect] = (held_out_of_all(less.problem, less.solution) - left) / count
        effects = [end.solution.model.effect(test.effect) for test in tests]
        budget = partial.budget_with(frozenset(map(partial.kind_of, effects)))
        entries = {entry.kind: entry for entry in budget.entries}
        rest = end.flexible.explained / max(int(end.problem.used.sum()), 1)  # less may be a part of that
        unexplained = max(end.rmse**2 - noise**2, 0.0)
        # Together they leave as little as the laws of all kinds that count, and little of the whole error.
        share_left = left / count / partial.budget.base**2
        is_as_good = share_left <= min(partial.budget.left / AS_GOOD, 1.0 - MOST_OF_LAW)
        least = max(SMALL * search.start.held_out_mean_square, rest, _OF_UNEXPLAINED * unexplained)
        failed = [
            test.effect
            for test in tests
            if not (test.is_known or is_as_good)
            or _repeats_another(end, test.effect, taken)
            or not _accounts_for_error(
                search, partial, end, test, entries, taken=taken[test.effect], unexplained=unexplained
            )
            or taken[test.effect] < least
            or not search.is_sound(end, test.effect)
            or (test.kind is Kind.RUN_DIFFERENCES and len(end.data.runs) < _RUNS)
        ]
        if failed:
            end = search.without(end, min(failed, key=lambda name: taken[name]))
            continue
        others = [fit for test in tests for fit in similar_forms(search, end, test.effect).values()]
        better = [fit for fit in others if search.is_sensible(fit) and search.is_better(fit, end)]
        better = better or [
            fit
            for test in tests
            for fit in _of_the_object(search, end, test.effect)
            if search.is_sensible(fit)
        ]
        if not better:
            is_real = improvement_test(search.start, end, measurement, search.rng).is_significant
            return (end, tests) if is_real else (search.start, [])
        end = min(better, key=lambda fit: fit.solution.held_out)
    return search.start, []


def _repeats_another(end: FitResult, name: str, taken: Mapping[str, float]) -> bool:
    """Whether a more telling effect is of the same kind: two forms of a kind draw almost any third."""
    effects = {effect.name: effect for effect in end.solution.model.effects if effect.name in taken}
    own = effects[name]
    return any(other.kind is own.kind and taken[other.name] > taken[name] for other in effects.values())


def _accounts_for_error(
    search: Search,
    partial: PartiallyLinear,
    end: FitResult,
    test: FormTest,
    entries: Mapping[Kind, BudgetEntry],
    *,
    taken: float,
    unexplained: float,
) -> bool:
    """Whether an effect's kind accounts for a part of the error that no other kind takes in its place.

    A kind without a law of its own is taken at its effect's word, and so is an effect that alone leaves less
    than the laws of all kinds together. A share counts only for a kind of the smallest set, or where kind and
    effect take as much in the place of a kind of it: beside that, a needless law has a share too. Beside
    little that nothing explains, or where it takes as much, a form is told from another kind's law by its few
    parameters.

    Args:
        search: that led to the model.
        partial: the kinds that account for the error.
        end: the model.
        test: of the effect.
        entries: the budget, with the effect's kind in it.
        taken: mean square that the effect takes away in the model [effort^2].
        unexplained: mean square that nothing explains [effort^2].
    """
    effect, start = end.solution.model.effect(test.effect), search.start
    own = [entries[kind] for kind in effect.also | {test.kind} if kind in entries]
    if not own:
        return True
    entry = max(own, key=lambda entry: entry.share)
    in_its_place = [partial.kinds - {entry.kind} | {other} for other in entry.replaceable_by]
    by_others = min(map(partial.error.mean_square, in_its_place), default=-np.inf)
    is_told_apart = not entry.replaceable_by or unexplained < _UNDECIDED * taken
    is_told_apart |= AS_GOOD * test.left_by_all <= by_others
    stands_in = any(taken >= least for least in _least_in_place(partial, entry))
    is_counted = (entry.kind in partial.kinds or stands_in) and is_told_apart
    if entry.necessary >= _LEAST_OF_KIND or (entry.share >= _LEAST_OF_KIND and is_counted):
        return True
    alone = search.fitted(start.solution.model.with_effect(effect), end.solution.parameters)
    return bool(alone.held_out_mean_square < partial.budget.flexible * start.held_out_mean_square)


def _least_in_place(partial: PartiallyLinear, entry: BudgetEntry) -> Iterator[float]:
    """Mean square that an effect must take in the place of each kind's law for which its own kind stands in.

    It is as much, or most of it where the effect's kind is the more plausible one, as object before reader.

    Args:
        partial: the kinds that account for the error.
        entry: of the effect's kind, with the budget's other kinds beside it.
    """
    order, left = list(Kind), partial.error.mean_square(partial.kinds)
    for replaced in partial.budget.entries:
        if entry.kind in partial.stand_ins(replaced):
            by_law = partial.error.mean_square(partial.kinds - {replaced.kind}) - left
            is_likelier = order.index(entry.kind) < order.index(replaced.kind)
            yield (MOST_OF_LAW if is_likelier else AS_MUCH) * by_law


def smallest_sufficient_model(search: Search, end: FitResult, measurement: MeasurementModel) -> FitResult:
    """The first part of a model from which draws gain as much by the whole; some need each other.

    Args:
        search: of the channel.
        end: the whole model.
        measurement: how motion and effort were read.
    """
    parts = (search.start, *models_by_importance(search, end)[:-1])
    enough = (
        part for part in parts if not improvement_test(part, end, measurement, search.rng).is_significant
    )
    return next(enough, end)


def _without_needless(search: Search, end: FitResult, measurement: MeasurementModel) -> FitResult:
    """A model less the effects that it does not need, the least telling first."""
    for name in reversed(effects_by_importance(search, end)):
        before = search.without(end, name)
        is_small = before.rmse - end.rmse < SMALL * (search.start.rmse - end.rmse)
        taken = np.sqrt(max(before.held_out_mean_square - end.held_out_mean_square, 0.0))
        is_nothing = is_small or _is_below_a_step(search, end, name) or _may_be_nothing(before, end, name)
        is_nothing |= bool(taken <= encoder_step_error(before, measurement))
        needed = not is_nothing and search.is_needed(before, end)
        if needed and improvement_test(before, end, measurement, search.rng, name).is_significant:
            continue
        if search.is_sensible(before):  # or another effect would take over what this one says
            end = before
    return end


def effects_by_importance(search: Search, end: FitResult) -> list[str]:
    """The effects of a model beside the base model's, the most telling first.

    Args:
        search: of the channel.
        end: the model that the search ended with.
    """
    path = [search.start, *models_by_importance(search, end)]
    return [
        name
        for before, after in pairwise(path)
        for name in set(search.added_effects(after)) - set(search.added_effects(before))
    ]


def models_by_importance(search: Search, end: FitResult) -> list[FitResult]:
    """The models on the way from the base to the end, the most telling effect first.

    Args:
        search: of the channel.
        end: the model that the search ended with.
    """
    path = [end]
    while search.added_effects(path[0]):
        less = [search.without(path[0], name) for name in search.added_effects(path[0])]
        path.insert(0, min(less, key=lambda one: one.solution.held_out))
    return path[1:]


def indistinguishable_models(
    search: Search, end: FitResult, name: str, measurement: MeasurementModel
) -> dict[str, FitResult]:
    """Models with another effect in the place of one that the data do not refuse, by its name, best first.

    Args:
        search: of the channel.
        end: the model that the search ended with.
        name: the effect that is replaced.
        measurement: how motion and effort were read.
    """
    alone = {one.effect.name: search.with_candidate(one) for one in _rivals(search, end, name, measurement)}
    wholes = ((whole, _with_whole(search, end, whole)) for whole in _wholes(search, end, name))
    kept = (
        (w, made)
        for w, made in wholes
        if not improvement_test(made, end, measurement, search.rng).is_significant
    )
    return alone | {whole.name: made for whole, made in kept}


def similar_forms(search: Search, end: FitResult, name: str) -> dict[str, FitResult]:
    """Models with another form of the same kind, of as few parameters, that takes about as much.

    Args:
        search: of the channel.
        end: the model that the search ended with.
        name: the effect that is replaced.
    """
    effect = end.solution.model.effect(name)
    without = search.without(end, name).solution.held_out
    least = without - AS_MUCH * (without - end.solution.held_out)
    return {
        candidate.effect.name: search.with_candidate(candidate)
        for candidate in search.alternatives(end, name)
        if candidate.effect.name != name
        and candidate.effect.kind is effect.kind
        and parameter_count(candidate.effect) <= parameter_count(effect)
        and candidate.held_out <= least
    }


def _of_the_object(search: Search, end: FitResult, name: str) -> Iterator[FitResult]:
    """Models with an effect of the object or the drive in the place of one of the reader.

    A reader is seldom at fault: it is only where nothing that it reads, with as few parameters, takes about
    as much.

    Args:
        search: of the channel.
        end: the model that the search ended with.
        name: the effect that is replaced.
    """
    effect = end.solution.model.effect(name)
    if effect.kind not in _OF_READER:
        return
    without = search.without(end, name).solution.held_out
    least = without - AS_MUCH * (without - end.solution.held_out)
    for candidate in search.alternatives(end, name):
        of_object = candidate.effect.kind not in _OF_READER | {Kind.RUN_DIFFERENCES, Kind.DRIFT, Kind.OTHER}
        if of_object and parameter_count(candidate.effect) <= parameter_count(effect):
            fit = search.with_candidate(candidate)
            if fit.solution.held_out <= least:
                yield fit


def _wholes(search: Search, end: FitResult, name: str) -> list[Effect]:
    """Effects of which one is a part, and others of the model are the rest."""
    present = {one.name for one in end.solution.model.effects}
    known = (one for one in search.effects if name in one.parts and one.name not in present)
    return [one for one in known if present >= set(one.parts) and one.applies_to(end.data)]


def _with_whole(search: Search, end: FitResult, whole: Effect) -> FitResult:
    """A model with an effect in the place of all its parts but those of the base model."""
    for part in search.added_effects(end):
        end = search.without(end, part) if part in whole.parts else end
    return search.with_each(end, [whole])


def most_parsimonious(
    search: Search, end: FitResult, measurement: MeasurementModel, is_complete: Complete
) -> FitResult:
    """The model with each effect exchanged for one of fewer parameters, or of as many that leaves less.

    Of laws that cannot be told apart, the simplest bears the name (W. H. Jefferys, J. O. Berger, American
    Scientist 80 (1992)); it must leave no more than the other did.

    Args:
        search: that led to the model.
        end: base model and effects that are established.
        measurement: how the motion was read.
        is_complete: whether a model leaves no more than draws from it do.
    """
    for name in effects_by_importance(search, end):
        effect = end.solution.model.effect(name)
        if _is_undetermined(end, effect) and (simpler := _simpler(search, end, effect)) is not end:
            end = simpler
            continue
        made = map(search.with_candidate, _rivals(search, end, name, measurement, parameter_count(effect)))
        kept = [one for one in made if search.is_better(one, end) and is_complete(one) >= is_complete(end)]
        end = min(kept, key=lambda one: (search.size(one), one.solution.held_out), default=end)
    return end


def _is_undetermined(end: FitResult, effect: Effect) -> bool:
    """Whether the interval of a size or shape parameter of an effect holds zero, or is unknown."""
    estimates = estimate_parameters(*final_solution(end))
    own = [estimates[f"{effect.name}.{parameter.name}"] for parameter in (*effect.gains, *effect.inner)]
    return any(not abs(one.value) > 0.5 * np.ptp(one.interval) for one in own if not one.at_bound)


def _simpler(search: Search, end: FitResult, effect: Effect) -> FitResult:
    """The model with a simpler effect in the place of one, where it leaves at most a small share more."""
    others = [
        search.with_candidate(candidate)
        for candidate in search.alternatives(end, effect.name)[:_RIVALS]
        if parameter_count(candidate.effect) < parameter_count(effect)
        and candidate.followed(end.problem) <= NEAR * end.solution.held_out
    ]
    close = [fit for fit in others if fit.rmse <= (1.0 + SMALL) * end.rmse and search.is_sensible(fit)]
    return min(close, key=lambda fit: (search.size(fit), fit.solution.held_out), default=end)


def _rivals(
    search: Search, end: FitResult, name: str, measurement: MeasurementModel, most: float = np.inf
) -> Iterator[Candidate]:
    """Candidates of at most so many parameters that the data do not refuse in the place of one.

    One that needs more parameters to draw the same curve (a law with one more term) is no rival: the data say
    that the term is nothing.
    """
    without = search.without(end, name)
    others = [one for one in search.alternatives(end, name) if one.effect.name != name]
    half = 0.5 * (without.solution.held_out + end.solution.held_out)
    for candidate in others[:_RIVALS]:
        if parameter_count(candidate.effect) > most or candidate.followed(end.problem) > NEAR * half:
            continue
        theirs = search.with_candidate(candidate)
        if not search.is_sensible(theirs):
            continue
        is_larger = search.size(theirs) > search.size(end) + 1  # one more may be a place or a phase
        if theirs.solution.held_out > half or (is_larger and _is_same_curve(theirs, end, without)):
            continue
        if not improvement_test(theirs, end, measurement, search.rng).is_significant:
            yield candidate


def _is_same_curve(one: FitResult, other: FitResult, without: FitResult) -> bool:
    """Whether two models predict the same, beside what both add to a third."""
    here, there, before = (fit.solution.residual for fit in (one, other, without))
    if not len(here) == len(there) == len(before):  # the contact begins elsewhere
        return False
    apart, added = here - there, before - there
    return float(apart @ apart) < _WITHIN * float(added @ added)


def _may_be_nothing(before: FitResult, end: FitResult, name: str) -> bool:
    """Whether each parameter that says how large an effect is may be zero, by its interval at `LEVEL`.

    These are its gains, or the first inner parameter of one without gains: a gap, a compliance, a time. Of an
    effect that takes away more of the squared error than is left, beside what windows took off the motion,
    this says no more than that its parameters make up for each other.
    """
    if end.flexible.before.sum() <= 0.5 * before.flexible.before.sum():
        return False
    effect = end.solution.model.effect(name)
    found = estimate_parameters(*final_solution(end))
    sizes = [found[f"{name}.{one.name}"] for one in effect.gains or effect.inner[:1]]
    return not any(abs(one.value) > 0.5 * _SURE * np.ptp(one.interval) for one in sizes)


def _is_below_a_step(search: Search, end: FitResult, name: str) -> bool:
    """Whether an effect adds no more than the reader's rounding does, which looks like a law too."""
    step = grid_step(np.sort(end.data.effort))
    without = search.without(end, name)
    added = np.sqrt(max(without.rmse**2 - end.rmse**2, 0.0))
    return bool(name != "quantisation" and step > 0.0 and added < step / np.sqrt(12.0) and end.rmse < step)
