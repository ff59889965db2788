"""Compare effects with the flexible law of their kind, adjusted for flexible laws of the other kinds.

The error budget (`palpate.estimation.budget`) first determines the kinds of the missing effects. The forms of
a kind are then compared with the kind's flexible law on the residual of the other kinds' flexible laws
(partially linear model, P. M. Robinson, Econometrica 56 (1988)). A form can therefore be tested before all
other effects are known, and it need not be exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from palpate.estimation.budget.budget import BudgetEntry, ErrorBudget, error_budget
from palpate.estimation.budget.held_out import BestVariant, HeldOutError, Kinds, SquaredErrors
from palpate.estimation.budget.laws import BaseColumns, FlexibleLaw, flexible_laws
from palpate.estimation.channel import ChannelKind
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.diagnosis.candidates import (
    REFINED,
    Candidate,
    applicable_effects,
    cross_validated_error,
    extended_models,
    parameter_count,
    quick_screen,
    screen_effects,
)
from palpate.estimation.diagnosis.search import TIE, Search
from palpate.estimation.effect import Effect
from palpate.estimation.effects.run_differences import RunVariation
from palpate.estimation.fit.blocks import HEAVY
from palpate.estimation.fit.fit_problem import FitProblem, Solution, solve_gains
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.inner_search import optimize_inner
from palpate.estimation.fit.normal_equations import held_out_sse, nuisance_of
from palpate.estimation.fit.smoothing_bias import fit_smoothing_bias
from palpate.estimation.kinds import SENSOR_KINDS, Kind
from palpate.estimation.model import Model
from palpate.estimation.signals.runwise import shifted_motion
from palpate.robot_io.types import FloatArray

_RIDGES = (1e-6, 1e-4, 1e-2)  # tried ridge penalties of a law
_COLLINEAR = 1e-9  # ridge penalty of the model's own columns
MOST_OF_LAW = 0.8  # least ratio of the mean squares explained by an accepted form and by its kind's law
_MIN_TRIED = 0.5  # the same for a form that is tried in a model with the forms of all kinds
AS_GOOD = 0.9  # a flexible regression that leaves less than this share of a model's squared error is better
AS_MUCH = 0.95  # ratio of explained mean squares above which forms or kinds count as equivalent
SLOW = 1.5  # ratio of the error to the noise above which the error is slower than noise of the readings
_EXACT = 0.01  # largest mean square that the kind's law adds to an exact form, relative to the form's own
_MAX_SETS = 4  # sets of kinds whose forms are compared
_ROUNDS = 2  # rounds of backfitting
_OFFSET = "contact_offset.offset"  # parameter of the base model for the depth of the surface
_STEP = 1e-4  # step of a derivative by the position, relative to the range of motion


class Form(StrEnum):
    """How well the form of an effect is known."""

    EXACT = "exact"  # the model leaves only measured noise, and a flexible law of the kind adds nothing
    APPROXIMATE = "approximate"  # the form explains most of the error that its kind's flexible law explains
    UNKNOWN = "unknown"  # the kind is known, but no form explains most of its law's part of the error


@dataclass(frozen=True)
class FormTest:
    """Comparison of one effect with its kind's flexible law, adjusted for laws of the other kinds."""

    effect: str  # name of the effect
    kind: Kind
    explained_by_effect: float  # mean square that the effect explains [effort^2]
    # Mean square that the kind's law explains in its place, at least `explained_by_effect` [effort^2].
    explained_by_law: float
    added_by_law: float  # mean square that the law explains in addition [effort^2]
    unexplained: float  # mean square that remains with the effect [effort^2]
    unexplained_by_all: float = np.inf  # the same, adjusted for all other kinds that account for the error

    @property
    def share(self) -> float:
        """Mean square that the effect explains, relative to its kind's law."""
        return self.explained_by_effect / self.explained_by_law if self.explained_by_law > 0.0 else 0.0

    @property
    def is_known(self) -> bool:
        """Whether the effect explains most of the error that its kind's law explains.

        The threshold is lower for variation between runs, since the effect estimates a run's value from the
        first part of the run, but the law from one half of it.
        """
        return self.share >= (_MIN_TRIED if self.kind is Kind.RUN_DIFFERENCES else MOST_OF_LAW)

    @property
    def is_closed(self) -> bool:
        """Whether the kind's law adds nothing relevant to the effect."""
        return self.added_by_law < max(_EXACT * self.explained_by_effect, SMALL * self.unexplained)


@dataclass(frozen=True)
class PartiallyLinear:
    """A channel's base model with the flexible laws of the kinds that account for its error."""

    search: Search  # the channel, or a coarse copy of it
    laws: tuple[FlexibleLaw, ...]
    budget: ErrorBudget
    error: BestVariant

    @property
    def kinds(self) -> Kinds:
        """Kinds that account for the error."""
        return frozenset(self.budget.kinds)

    def kind_of(self, effect: Effect) -> Kind:
        """Return the kind of an effect that accounts for most of the error, or its first kind.

        Args:
            effect: the effect, which may belong to several kinds.
        """
        own = effect.also | {effect.kind}
        return next((kind for kind in self.budget.kinds if kind in own), effect.kind)

    def replacements(self, entry: BudgetEntry) -> Kinds:
        """Return the kinds that can replace a kind: together with the other kinds they explain as much.

        Args:
            entry: budget entry of the kind.
        """
        base = self.error.mean_square()
        least = AS_MUCH * (base - self.error.mean_square(self.kinds))
        rest = self.kinds - {entry.kind}
        return frozenset(
            other for other in entry.replaceable_by if base - self.error.mean_square(rest | {other}) >= least
        )

    def budget_with(self, named: Kinds) -> ErrorBudget:
        """Divide the error among the kinds that account for it and the kinds of named effects.

        A kind without a named effect is omitted if a kind of a named effect explains as much in its place.

        Args:
            named: kinds of the named effects.
        """
        replaced = {e.kind for e in self.budget.entries if named & self.replacements(e)} - named
        return error_budget(self.error, np.random.default_rng(0), self.kinds - replaced | named)

    def _adjust_problem(self, own: Kinds, kinds: Kinds, problem: FitProblem, base: Solution) -> FitProblem:
        """Return a problem adjusted for the laws of all kinds but an effect's own (orthogonal projection)."""
        others = kinds - own
        blocked = problem.blocked
        bias = np.empty((len(blocked), 0))
        if own & SENSOR_KINDS:  # which flatten the effort like the smoothing of the motion
            bias, _ = fit_smoothing_bias(problem, base, self.search.start.filters)
        shared = [law for law in self.laws if Kind.RUN_DIFFERENCES not in law.kinds]
        columns = [law.columns for law in shared if law.kinds <= others]
        by_run = np.empty((len(blocked), 0))
        if Kind.RUN_DIFFERENCES in others:
            by_run = np.column_stack([np.ones(len(blocked)), blocked.effort - base.residual])
        stacked = np.hstack([bias, *columns])
        return replace(problem, nuisance=nuisance_of(stacked, by_run, blocked.run, problem.used))

    def _law_columns(self, own: Kinds, kinds: Kinds) -> FloatArray:
        """Return the columns (m, k) of the laws of some kinds and of their interactions with others."""
        shared = [law for law in self.laws if Kind.RUN_DIFFERENCES not in law.kinds]
        laws = [law.columns for law in shared if own & law.kinds and law.kinds <= kinds | own]
        return np.hstack(laws) if laws else np.empty((len(self.search.start.problem.blocked), 0))


def analyze_kinds(search: Search) -> PartiallyLinear:
    """Determine the kinds that account for the base model's held-out error.

    Args:
        search: the search of the channel.
    """
    error = error_of_kinds(search.start)
    budget = error_budget(error, np.random.default_rng(0))
    return PartiallyLinear(search, tuple(error.laws), budget, error)


def error_of_kinds(start: FitResult, *, with_laws: bool = True) -> BestVariant:
    """Prepare the held-out errors of a fitted model with the flexible laws of any set of kinds.

    Args:
        start: the base model.
        with_laws: whether to compute the laws; without them, only the error of the model itself is known.
    """
    blocked, solution, used = start.problem.blocked, start.solution, start.problem.used
    base, target = _base_columns(start)
    if not with_laws:
        return BestVariant([HeldOutError(base, (), target, blocked, used)])
    # A lag hardly changes a spring. If the damping were refitted too, a lag at one frequency would distort
    # it.
    has_spring = any(effect.kind is Kind.ELASTIC_SHAPE for effect in solution.model.effects)
    refitted = None if has_spring else base
    is_contact = blocked.data.kind is ChannelKind.CONTACT  # whose laws do not use the slope
    slope = np.zeros(len(blocked)) if is_contact else blocked.reduce(_slope_by_position(start))
    effort = blocked.effort - solution.residual
    has_weight = "load" in blocked.data.context and any(e.name in HEAVY for e in solution.model.effects)
    laws = flexible_laws(
        blocked, refitted, effort, solution.residual, used, slope=slope, has_weight=has_weight
    )
    error = HeldOutError(base, laws, target, blocked, used)
    if is_contact and Kind.FRICTION in error.kinds:
        # Friction acts on the sides of the tool, or inside the object. The object only pushes, so the second
        # one ends with the contact. The data decide.
        inside = [replace(law, one_sided=law.one_sided or Kind.FRICTION in law.kinds) for law in laws]
        errors = error, HeldOutError(base, inside, target, blocked, used)
        error = min(errors, key=lambda error: error.mean_square(frozenset({Kind.FRICTION})))
    if _OFFSET not in solution.parameters:
        return BestVariant([error])
    # The fitted surface of a wrong model may be far from the first touch, where a better law begins.
    at_touch = replace(solution, parameters={**solution.parameters, _OFFSET: 0.0})
    base, target = _base_columns(replace(start, solution=at_touch))
    other = HeldOutError(base, error.laws, target, blocked, used)
    sets = [frozenset(error.kinds), *(frozenset({kind}) for kind in error.kinds)]
    is_better = any(other.mean_square(kinds) < AS_GOOD * error.mean_square(kinds) for kinds in sets)
    return BestVariant([error, other] if is_better else [error])


def _slope_by_position(fit: FitResult) -> FloatArray:
    """Return the derivative of the predicted effort with respect to the position, shape (n,)."""
    data, step, zero = fit.data, _STEP * fit.data.range_of_motion, np.zeros(len(fit.data))
    efforts = [
        fit.model.predict(shifted_motion(data, np.full(len(data), part), zero, zero), fit.solution.parameters)
        for part in (step, -step)
    ]
    return np.asarray((efforts[0] - efforts[1]) / (2.0 * step))


def replacing_kinds(search: Search, end: FitResult) -> dict[str, dict[Kind, float]]:
    """Find the kinds whose flexible law, in place of an effect, describes the data about as well.

    A law that the library lacks may then be the right one. Several effects may together imitate it, so each
    kind also replaces all effects at once. Differences between runs and the effect's own kind are never
    tried, nor, in place of one effect, the other effects' kinds, since their laws can imitate a part of it.

    Args:
        search: the search of the channel.
        end: the final model.

    Returns:
        For each added effect, the replacing kinds with the mean square error that they add [effort^2].
    """
    names, left = search.added_effects(end), error_of_kinds(end, with_laws=False).mean_square()
    own = {name: (effect := end.solution.model.effect(name)).also | {effect.kind} for name in names}

    def replacements(reduced: FitResult, omitted: Kinds) -> dict[Kind, float]:
        error = error_of_kinds(reduced)
        allowance = _EXACT * (error.mean_square() - left) + SMALL * left
        limit = left + min(allowance, (SLOW**2 - 1.0) * left)
        kinds = frozenset(error.kinds) - omitted - {Kind.RUN_DIFFERENCES}
        by_law = {kind: error.mean_square(frozenset({kind})) for kind in kinds}
        return {kind: max(e - left, 0.0) for kind, e in by_law.items() if e <= limit}

    of_all = replacements(search.start, frozenset()) if len(names) > 1 else {}
    replacing = {}
    for name in names:
        found = replacements(search.without(end, name), frozenset().union(*own.values()))
        for kind in of_all.keys() - own[name]:
            found[kind] = min(of_all[kind], found.get(kind, np.inf))
        replacing[name] = found
    return replacing


def imitating_effect(search: Search, end: FitResult, names: Sequence[str] | None = None) -> str | None:
    """Return an added effect that only imitates another kind, whose own form the library may lack; else None.

    In its place, the flexible law of the other kind leaves clearly less error than the effect and than the
    law of its own kind, and the effect adds nothing to it (encompassing test; G. E. Mizon, J.-F. Richard,
    Econometrica 54 (1986)).

    Args:
        search: the search of the channel.
        end: the final model.
        names: added effects to check; None for all.
    """
    added = search.added_effects(end)
    # Kinds are compared by linear models, in which a sensor effect follows a force that is not cut off where
    # the tip leaves the object.
    left = min(error_of_kinds(end, with_laws=False).mean_square(), end.held_out_mean_square)
    own = {name: (effect := end.solution.model.effect(name)).also | {effect.kind} for name in added}
    for name in added if names is None else names:
        error = error_of_kinds(search.without(end, name))
        others = frozenset(error.kinds) - frozenset().union(*own.values()) - {Kind.RUN_DIFFERENCES}
        law = min((frozenset({kind}) for kind in others), key=error.mean_square, default=None)
        limit = AS_GOOD * min(left, error.mean_square(own[name] & frozenset(error.kinds)))
        if law is not None and (least := error.mean_square(law)) < limit:
            beside_law = error_of_kinds(end).mean_square(law)
            if beside_law >= AS_GOOD * least:
                return name
    return None


def _base_columns(start: FitResult) -> tuple[BaseColumns, FloatArray]:
    """Linearize the base model with the smoothing bias of derived motion; return columns and target."""
    solution, problem = start.solution, start.problem
    model, blocked, parameters = solution.model, problem.blocked, solution.parameters
    slopes, effort = model.linearize(blocked.data, parameters, lift_off_rows=np.empty(0, dtype=np.int64))
    columns = blocked.reduce(slopes)
    gains = np.array([parameters[name] for name in model.gains])
    target = blocked.reduce(blocked.data.effort - effort) + columns @ gains
    lower = np.array([parameter.lower for parameter in model.gains.values()])
    one_sided = model.one_sided & (blocked.data.kind is ChannelKind.CONTACT)
    bias, _ = fit_smoothing_bias(problem, solution, start.filters)
    count = bias.shape[1]
    base = BaseColumns(
        np.hstack([columns, bias]),
        np.append(gains, np.zeros(count)),
        np.append(lower, np.full(count, -np.inf)),
        np.append(one_sided, np.zeros(count, bool)),
    )
    return base, target


def named_forms(partial: PartiallyLinear) -> FitResult:
    """Fit the base model with the best form of each kind, if it has one, with all parameters jointly.

    If the laws of several sets of kinds explain about as much, the set with the best fitting forms is used,
    and of these the one with the fewest parameters.

    Args:
        partial: flexible laws of the kinds that account for the error.
    """
    exchanged = [
        partial.kinds - {entry.kind} | {other}
        for entry in partial.budget.entries
        for other in entry.replaceable_by
    ]
    budget = partial.budget
    sets = list(dict.fromkeys((partial.kinds, budget.sufficient_kinds, *budget.alternatives, *exchanged)))[
        :_MAX_SETS
    ]
    search, fits = partial.search, [_forms_of(partial, kinds) for kinds in sets]
    if Kind.TIME_MEMORY in partial.kinds:
        fits += _products(partial)
    sound = [fit for fit in fits if search.is_sensible(fit)] or fits
    least = min(fit.solution.held_out for fit in sound)
    near = [fit for fit in sound if fit.solution.held_out <= (1.0 + TIE) * least]
    return min(near, key=lambda fit: (search.size(fit), fit.solution.held_out))


def _forms_of(partial: PartiallyLinear, kinds: Kinds) -> FitResult:
    """Select the form of each kind by backfitting, given the other kinds' forms and flexible laws."""
    search = partial.search
    chosen: dict[Kind, tuple[Effect, dict[str, float]]] = {}
    forms = dict[object, tuple[Effect, dict[str, float]] | None]()  # by the kind and the other kinds' forms
    for _ in range(_ROUNDS):
        for kind in sorted(kinds, key=list(Kind).index):
            if kind in {Kind.RUN_DIFFERENCES, Kind.RECORDED_CONTEXT}:
                continue
            others = [pair for other, pair in chosen.items() if other is not kind]
            key = kind, tuple((effect.name, effect.form, *inner.items()) for effect, inner in others)
            if key not in forms:
                forms[key] = _best_form(partial, kind, kinds, others)
            chosen.pop(kind, None)
            if (form := forms[key]) is not None:
                chosen[kind] = form
    model, parameters = search.model, dict(search.start.solution.parameters)
    for effect, inner in chosen.values():
        model, parameters = model.with_effect(effect), {**parameters, **inner}
    return _with_run_differences(partial, kinds, model, parameters)


def _products(partial: PartiallyLinear) -> list[FitResult]:
    """Fit the base model with each law of memory and the elastic shape that suits it best."""
    # The memory of a viscoelastic object acts on its elastic force (quasi-linear viscoelasticity; Y. C. Fung,
    # Biomechanics (1993), ch. 7). The law is a product, so neither factor can be fitted without the other.
    pair_kinds = frozenset({Kind.ELASTIC_SHAPE, Kind.TIME_MEMORY})
    start, kinds = partial.search.start, partial.kinds | pair_kinds
    problem = partial._adjust_problem(pair_kinds, kinds, start.problem, start.solution)
    library = applicable_effects(start.data, start.solution.model, partial.search.effects)
    shapes = [effect for effect in library if effect.kind is Kind.ELASTIC_SHAPE]
    fits = []
    for memory in (effect for effect in library if effect.kind is Kind.TIME_MEMORY):
        pairs = list[Candidate]()
        for model in extended_models(start.solution.model, memory):
            for inner in memory.starts(start.data):
                values = start.solution.parameters | {f"{memory.name}.{n}": v for n, v in inner.items()}
                alone = FitResult(start.data, problem, solve_gains(problem, model, values))
                pairs += quick_screen(alone, shapes)[:1]
        if pairs:
            best = min(pairs, key=lambda pair: pair.held_out).search.best
            best = optimize_inner(problem, solve_gains(problem, best.model, best.parameters))
            fits.append(_with_run_differences(partial, kinds, best.model, best.parameters))
    return fits


def _with_run_differences(
    partial: PartiallyLinear, kinds: Kinds, model: Model, parameters: Mapping[str, float]
) -> FitResult:
    """Fit a model with the effect that describes differences between runs best, or without one."""
    search, alone = partial.search, partial.search.fitted(model, parameters)
    if Kind.RUN_DIFFERENCES not in kinds:
        return alone
    fits = [alone]
    for effect in search.effects:
        is_of_runs = isinstance(effect, RunVariation) and effect.applies_to(alone.data)
        if is_of_runs and (effect.name != "run_ripple" or Kind.PERIODIC in kinds):
            start = {f"{effect.name}.{n}": v for n, v in effect.starts(alone.data)[-1].items()}
            extended = search.refitted(model.with_effect(effect), {**parameters, **start})
            fits += [extended] if search.is_sound(extended, effect.name) else []
    best = min(fits, key=lambda candidate: candidate.solution.held_out)
    return best if best.rmse < (1.0 - SMALL) * alone.rmse else alone


def _screen_kind(
    partial: PartiallyLinear,
    kind: Kind,
    kinds: Kinds,
    others: Sequence[tuple[Effect, dict[str, float]]] = (),
    refined: int = REFINED,
) -> tuple[FitResult, list[Candidate]]:
    """Fit effects of a kind, adjusted for laws of other kinds; return the fit without, and possible ones."""
    start = partial.search.start
    model, parameters = start.solution.model, dict(start.solution.parameters)
    for effect, inner in others:
        model, parameters = model.with_effect(effect), {**parameters, **inner}
    problem = partial._adjust_problem(frozenset({kind}), kinds, start.problem, start.solution)
    null = FitResult(start.data, problem, solve_gains(problem, model, parameters))
    library = applicable_effects(start.data, model, partial.search.effects)
    effects = [effect for effect in library if kind in effect.also | {effect.kind}]
    candidates = screen_effects(null, effects, refined=refined)
    return null, [candidate for candidate in candidates if candidate.possible]


def _best_form(
    partial: PartiallyLinear, kind: Kind, kinds: Kinds, others: Sequence[tuple[Effect, dict[str, float]]]
) -> tuple[Effect, dict[str, float]] | None:
    """Select the simplest form that explains nearly as much as the best form, with its inner parameters."""
    null, candidates = _screen_kind(partial, kind, kinds, others)
    left = null.solution.held_out
    law_gain = left - _with_law(null.problem, null.solution, partial._law_columns(frozenset({kind}), kinds))
    largest = max((left - candidate.held_out for candidate in candidates), default=0.0)
    if largest <= _MIN_TRIED * law_gain or largest <= 0.0:
        return None
    near = [candidate for candidate in candidates if left - candidate.held_out >= AS_MUCH * largest]
    best = min(near, key=lambda candidate: (parameter_count(candidate.effect), candidate.held_out))
    solution = best.search.best
    effect = solution.model.effect(best.effect.name)
    names = [f"{effect.name}.{parameter.name}" for parameter in effect.inner]
    return effect, {name: solution.parameters[name] for name in names}


def closest_forms(partial: PartiallyLinear, kind: Kind, kinds: Kinds) -> list[str]:
    """List the two effects of a kind that explain most, adjusted for laws of the other kinds, the best first.

    Args:
        partial: flexible laws of the kinds that account for the error.
        kind: the kind whose effects are compared.
        kinds: all kinds that account for the error.
    """
    null, candidates = _screen_kind(partial, kind, kinds, refined=0)
    limit = (1.0 - SMALL) * null.solution.held_out
    return [candidate.effect.name for candidate in candidates if candidate.held_out < limit][:2]


def _with_law(problem: FitProblem, solution: Solution, columns: FloatArray) -> float:
    """Compute the squared held-out error of a model with a flexible law [effort^2]."""
    if columns.shape[1] == 0:
        return solution.held_out
    equations = problem.normal_equations([solution.columns, columns], solution.target)
    own = solution.columns.shape[1]
    ridges = np.array([[_COLLINEAR] * own + [ridge] * columns.shape[1] for ridge in _RIDGES])
    return min(float(held_out_sse(equations, ridges).sum(axis=1).min()), solution.held_out)


def form_tests(partial: PartiallyLinear, end: FitResult, kinds: Kinds = frozenset()) -> list[FormTest]:
    """Compare each added effect with its kind's flexible law, given the other effects and kinds' laws.

    Args:
        partial: flexible laws of the kinds that account for the base model's error, on the same blocks.
        end: base model and effects.
        kinds: additional kinds whose laws are included.
    """
    base = {effect.name for effect in partial.search.model.effects}
    added = [effect for effect in end.solution.model.effects if effect.name not in base]
    own = [effect for effect in added if not isinstance(effect, RunVariation)]
    kinds = partial.kinds | kinds | {effect.kind for effect in own}
    if len(own) < len(added):
        kinds -= {Kind.RUN_DIFFERENCES}  # an effect of the model describes them
    tests = []
    for effect in own:
        beside_all = _form_test(partial, end, effect, kinds)
        # The law of a kind without an effect in the model may absorb this effect.
        beside_named = _form_test(partial, end, effect, frozenset(other.kind for other in own))
        test = max(beside_all, beside_named, key=lambda test: test.share)
        tests.append(replace(test, unexplained_by_all=beside_all.unexplained))
    tests += [_run_test(partial, end, kinds, e.name) for e in added if isinstance(e, RunVariation)]
    return tests


def _form_test(partial: PartiallyLinear, end: FitResult, effect: Effect, kinds: Kinds) -> FormTest:
    """Compare one effect with the flexible law of its kind, adjusted for laws of the given kinds."""
    model, known = end.solution.model, end.solution.parameters
    own = effect.also | {effect.kind}
    problem = partial._adjust_problem(own, kinds, end.problem, end.solution)
    with_it = solve_gains(problem, model, known)
    without = solve_gains(problem, model.without(effect.name), known)
    columns = partial._law_columns(own, kinds)
    law, both = _with_law(problem, without, columns), _with_law(problem, with_it, columns)
    count = max(int(end.problem.used.sum()), 1)
    # All parameters must be fitted without the held-out run, like those of the law.
    left = cross_validated_error(problem, with_it)
    explained_by_effect = cross_validated_error(problem, without) - left
    explained_by_law = max(without.held_out - law, without.held_out - both, explained_by_effect)
    return FormTest(
        effect.name,
        effect.kind,
        explained_by_effect / count,
        explained_by_law / count,
        (with_it.held_out - both) / count,
        left / count,
    )


def _run_test(partial: PartiallyLinear, end: FitResult, kinds: Kinds, name: str) -> FormTest:
    """Compare a variation between runs with a free gain and zero per run, adjusted for flexible laws."""
    own = frozenset({Kind.RUN_DIFFERENCES})
    model, known = end.solution.model, end.solution.parameters
    problem = partial._adjust_problem(own, kinds, end.problem, end.solution)
    with_it = solve_gains(problem, model, known).held_out
    without = solve_gains(problem, model.without(name), known).held_out
    free_problem = partial._adjust_problem(frozenset(), kinds | own, end.problem, end.solution)
    law = solve_gains(free_problem, model.without(name), known).held_out
    count = max(int(end.problem.used.sum()), 1)
    explained_by_effect = (without - with_it) / count
    return FormTest(
        name,
        Kind.RUN_DIFFERENCES,
        explained_by_effect,
        max((without - law) / count, explained_by_effect),
        0.0,
        with_it / count,
    )


@dataclass
class NamedFormsError(SquaredErrors):
    """Squared held-out errors of a model reduced to its effects of some kinds."""

    end: FitResult
    named: Mapping[str, Kind]  # kind of each added effect

    def __post_init__(self) -> None:
        """Number the runs of the blocks in use."""
        self._run = np.unique(self.end.problem.blocked.run[self.end.problem.used], return_inverse=True)[1]
        self._squares: dict[Kinds, FloatArray] = {}

    @property
    def kinds(self) -> list[Kind]:
        """Kinds of the effects."""
        return sorted(set(self.named.values()))

    def residual(self, kinds: Kinds) -> FloatArray:
        """See `SquaredErrors.residual`."""
        problem, model = self.end.problem, self.end.solution.model
        without = [name for name, kind in self.named.items() if kind not in kinds]
        solution = solve_gains(problem, model.without(*without), self.end.solution.parameters)
        gains = solution.linear_fit.fold_gains[problem.blocked.fold]
        left: FloatArray = solution.target - np.sum(solution.columns * gains, axis=1)
        return left[problem.used]
