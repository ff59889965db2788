"""Forms of effects within a kind, beside flexible laws of the other kinds.

What is missing is first told by kind (`palpate.estimation.budget`). Then each kind's forms are compared with
the kind's own flexible law, on what flexible laws of the other kinds cannot explain (partially linear model,
P. M. Robinson, Econometrica 56 (1988)). So a form need not wait until all other effects have a name, and it
need not be exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from palpate.estimation.budget.budget import BudgetEntry, ErrorBudget, error_budget
from palpate.estimation.budget.held_out import BaseColumns, HeldOutError, Kinds, SquaredErrors
from palpate.estimation.budget.laws import Law, flexible_laws
from palpate.estimation.channel import ChannelKind
from palpate.estimation.diagnosis.bootstrap import SMALL
from palpate.estimation.diagnosis.candidates import (
    applicable_effects,
    held_out_of_all,
    parameter_count,
    screen_effects,
)
from palpate.estimation.diagnosis.search import TIE, Search
from palpate.estimation.effect import Effect
from palpate.estimation.effects.run_differences import RunVariation
from palpate.estimation.fit.fit_problem import FitProblem, Solution, solve_gains
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.flexible_regression import is_plausible_bias, smoothing_bias
from palpate.estimation.fit.normal_equations import held_out_sse, nuisance_of, solve_normal_equations
from palpate.estimation.fit.run_heterogeneity import run_heterogeneity
from palpate.estimation.kinds import Kind
from palpate.robot_io.types import FloatArray

_RIDGES = (1e-6, 1e-4, 1e-2)
_COLLINEAR = 1e-9
MOST_OF_LAW = 0.8  # of what a kind's flexible law takes, that a form must take to bear its name
_HALF = 0.5  # of that, which a form must take to be tried in a model with all forms together
AS_MUCH = 0.95  # of what a form or a kind takes, from which another one draws the same curve
_EXACT = 0.01  # of what a form takes, that its kind's law may add
_MOST_SETS = 4  # of kinds, whose forms are compared
_ROUNDS = 2  # of seeking each kind's form beside the others'


class Form(StrEnum):
    """How well the form of an effect is known."""

    EXACT = "exact"  # the model leaves no more than noise, and a flexible law of the kind adds nothing
    APPROXIMATE = "approximate"  # it takes most of what a flexible law of its kind takes
    UNKNOWN = "unknown"  # the kind is known, and no form takes most of it


@dataclass(frozen=True)
class FormTest:
    """How one effect of a model compares with its kind's flexible law, beside laws of the other kinds."""

    effect: str  # its name
    kind: Kind
    taken: float  # mean square that it takes away [effort^2]
    by_law: float  # mean square that the kind's law takes away in its place, at least what the effect does
    added: float  # mean square that the law takes away beside it
    left: float  # mean square that is left beside it
    left_by_all: float = np.inf  # the same beside laws of all other kinds that account for the error

    @property
    def share(self) -> float:
        """Share of what the kind's law takes."""
        return self.taken / self.by_law if self.by_law > 0.0 else 0.0

    @property
    def is_known(self) -> bool:
        """Whether the effect takes most of what its kind's law takes.

        A run's own value is told by the first part of the run, the law's by half of it: less is asked of it.
        """
        return self.share >= (_HALF if self.kind is Kind.RUN_DIFFERENCES else MOST_OF_LAW)

    @property
    def is_closed(self) -> bool:
        """Whether the kind's law adds nothing that counts beside the effect."""
        return self.added < max(_EXACT * self.taken, SMALL * self.left)


@dataclass(frozen=True)
class PartiallyLinear:
    """A channel's base model with the flexible laws of the kinds that account for its error."""

    search: Search  # the channel, or a coarse copy of it
    laws: tuple[Law, ...]
    budget: ErrorBudget
    error: HeldOutError

    @property
    def kinds(self) -> Kinds:
        """Kinds that account for the error."""
        return frozenset(self.budget.kinds)

    def kind_of(self, effect: Effect) -> Kind:
        """The kind of an effect that accounts for most of the error; its first one where none does.

        Args:
            effect: which may belong to several kinds.
        """
        own = effect.also | {effect.kind}
        return next((kind for kind in self.budget.kinds if kind in own), effect.kind)

    def stand_ins(self, entry: BudgetEntry) -> Kinds:
        """Kinds that take as much in the place of one that accounts for the error, beside the others.

        Args:
            entry: of the kind in the budget.
        """
        base = self.error.mean_square()
        least = AS_MUCH * (base - self.error.mean_square(self.kinds))
        rest = self.kinds - {entry.kind}
        return frozenset(
            other for other in entry.replaceable_by if base - self.error.mean_square(rest | {other}) >= least
        )

    def budget_with(self, named: Kinds) -> ErrorBudget:
        """Divide the error among the kinds that account for it and those of effects with a name.

        A kind without a named effect gives way to a named one that takes as much in its place.

        Args:
            named: kinds of the effects.
        """
        replaced = {e.kind for e in self.budget.entries if named & self.stand_ins(e)} - named
        return error_budget(self.error, np.random.default_rng(0), self.kinds - replaced | named)

    def beside(self, own: Kinds, kinds: Kinds, problem: FitProblem, base: Solution) -> FitProblem:
        """Project a problem on what laws of the kinds other than an effect's own cannot explain.

        Args:
            own: the effect's own kind or kinds.
            kinds: all kinds that account for the error.
            problem: to be projected.
            base: the base model, fitted to it.
        """
        others = kinds - own
        blocked = problem.blocked
        shared = [law for law in self.laws if Kind.RUN_DIFFERENCES not in law.kinds]
        columns = [law.columns for law in shared if law.kinds <= others]
        empty = np.empty((len(blocked), 0))
        by_run = empty
        if Kind.RUN_DIFFERENCES in others:
            by_run = np.column_stack([np.ones(len(blocked)), blocked.effort - base.residual])
        stacked = np.hstack([empty, *columns])
        return replace(problem, nuisance=nuisance_of(stacked, by_run, blocked.run, problem.used))

    def law_columns(self, own: Kinds, kinds: Kinds) -> FloatArray:
        """Columns of the laws of some kinds and of their interactions with the others, shape (m, k).

        Args:
            own: kinds whose laws are taken.
            kinds: the others, with which their interactions count.
        """
        shared = [law for law in self.laws if Kind.RUN_DIFFERENCES not in law.kinds]
        laws = [law.columns for law in shared if own & law.kinds and law.kinds <= kinds | own]
        return np.hstack(laws) if laws else np.empty((len(self.search.start.problem.blocked), 0))


def analyse_kinds(search: Search, only: Kinds | None = None) -> PartiallyLinear:
    """Find the kinds that account for the base model's error in held-out runs.

    Args:
        search: of the channel.
        only: kinds that are known to be all; None to find them.
    """
    error = error_of_kinds(search.start)
    budget = error_budget(error, np.random.default_rng(0), only)
    return PartiallyLinear(search, tuple(error.laws), budget, error)


def error_of_kinds(start: FitResult) -> HeldOutError:
    """Prepare the held-out errors of a fitted model beside the flexible laws of any set of kinds.

    Args:
        start: the base model.
    """
    blocked, solution = start.problem.blocked, start.solution
    laws = flexible_laws(blocked, blocked.effort - solution.residual, solution.residual)
    base, target = _base_columns(start)
    return HeldOutError(base, laws, target, blocked, start.problem.used)


def _base_columns(start: FitResult) -> tuple[BaseColumns, FloatArray]:
    """The base model's columns, and what filters took off its derived motion; the effort that they explain.

    The object is not let go where the base model alone would have it: beside a law it may push there.
    """
    solution, problem = start.solution, start.problem
    model, blocked, parameters = solution.model, problem.blocked, solution.parameters
    slopes, effort = model.linearise(blocked.data, parameters, lifted=np.empty(0, dtype=np.int64))
    columns = blocked.reduce(slopes)
    gains = np.array([parameters[name] for name in model.gains])
    target = blocked.reduce(blocked.data.effort - effort) + columns @ gains
    lower = np.array([parameter.lower for parameter in model.gains.values()])
    one_sided = model.one_sided & (blocked.data.kind is ChannelKind.CONTACT)
    base = BaseColumns(columns, lower, one_sided)
    bias = smoothing_bias(blocked, blocked.effort - solution.residual, start.filters)
    count = bias.shape[1]
    if count:
        both = np.hstack([solution.columns, bias])
        fit = solve_normal_equations(problem.normal_equations(both, solution.target, list(model.gains)))
        better = fit.held_out.sum() < solution.held_out
        if better and is_plausible_bias(bias, fit.gains[-count:]):
            beside = np.hstack([columns, bias])
            base = BaseColumns(
                beside,
                np.append(lower, np.full(count, -np.inf)),
                np.append(base.one_sided, np.zeros(count, bool)),
            )
    return base, target


def named_forms(partial: PartiallyLinear) -> FitResult:
    """The base model with the best form of each kind that has one, all parameters fitted together.

    Where several sets of kinds explain about as much by their flexible laws, their forms decide; where these
    leave as much too, the fewest parameters.

    Args:
        partial: the base model beside flexible laws.
    """
    exchanged = [
        partial.kinds - {entry.kind} | {other}
        for entry in partial.budget.entries
        for other in entry.replaceable_by
    ]
    budget = partial.budget
    sets = list(dict.fromkeys((partial.kinds, budget.thorough, *budget.alternatives, *exchanged)))[
        :_MOST_SETS
    ]
    search, fits = partial.search, [_forms_of(partial, kinds) for kinds in sets]
    sound = [fit for fit in fits if search.is_sensible(fit)] or fits
    least = min(fit.solution.held_out for fit in sound)
    near = [fit for fit in sound if fit.solution.held_out <= (1.0 + TIE) * least]
    return min(near, key=lambda fit: (search.size(fit), fit.solution.held_out))


def _forms_of(partial: PartiallyLinear, kinds: Kinds) -> FitResult:
    """Seek each kind's form beside those of the others and flexible laws of the others (backfitting)."""
    search = partial.search
    chosen: dict[Kind, tuple[Effect, dict[str, float]]] = {}
    for _ in range(_ROUNDS):
        before = {kind: effect.name for kind, (effect, _) in chosen.items()}
        for kind in sorted(kinds, key=list(Kind).index):
            if kind in {Kind.RUN_DIFFERENCES, Kind.RECORDED_CONTEXT}:
                continue
            others = [pair for other, pair in chosen.items() if other is not kind]
            found = _best_form(partial, kind, kinds, others)
            chosen.pop(kind, None)
            if found is not None:
                chosen[kind] = found
        if before == {kind: effect.name for kind, (effect, _) in chosen.items()}:
            break
    model, parameters = search.model, dict(search.start.solution.parameters)
    for effect, inner in chosen.values():
        model, parameters = model.with_effect(effect), {**parameters, **inner}
    fit = search.fitted(model, parameters) if chosen else search.start
    return _with_run_differences(partial, kinds, fit)


def _with_run_differences(partial: PartiallyLinear, kinds: Kinds, fit: FitResult) -> FitResult:
    if Kind.RUN_DIFFERENCES not in kinds or run_heterogeneity(fit.problem.blocked, fit.solution) is None:
        return fit
    search, tried = partial.search, [fit]
    for effect in search.effects:
        is_of_runs = isinstance(effect, RunVariation) and effect.applies_to(fit.data)
        if is_of_runs and (effect.name != "run_ripple" or Kind.PERIODIC in kinds):
            start = {f"{effect.name}.{n}": v for n, v in effect.starts(fit.data)[-1].items()}
            model = fit.solution.model.with_effect(effect)
            made = search.fitted(model, {**fit.solution.parameters, **start})
            tried += [made] if search.is_sound(made, effect.name) else []
    best = min(tried, key=lambda one: one.solution.held_out)
    return best if best.rmse < (1.0 - SMALL) * fit.rmse else fit


def _best_form(
    partial: PartiallyLinear, kind: Kind, kinds: Kinds, others: Sequence[tuple[Effect, dict[str, float]]]
) -> tuple[Effect, dict[str, float]] | None:
    """The simplest of the forms that take nearly as much as the best, and its inner parameters."""
    start = partial.search.start
    model, parameters = start.solution.model, dict(start.solution.parameters)
    for effect, inner in others:
        model, parameters = model.with_effect(effect), {**parameters, **inner}
    problem = partial.beside(frozenset({kind}), kinds, start.problem, start.solution)
    none = solve_gains(problem, model, parameters, rounds=2)
    library = applicable_effects(start.data, model, partial.search.effects)
    effects = [effect for effect in library if kind in effect.also | {effect.kind}]
    if not effects:
        return None
    tried = [one for one in screen_effects(FitResult(start.data, problem, none), effects) if one.possible]
    taken = none.held_out - _with_law(problem, none, partial.law_columns(frozenset({kind}), kinds))
    most = max((none.held_out - one.held_out for one in tried), default=0.0)
    if most <= _HALF * taken or most <= 0.0:
        return None
    near = [one for one in tried if none.held_out - one.held_out >= AS_MUCH * most]
    best = min(near, key=lambda one: (parameter_count(one.effect), one.held_out))
    solution = best.search.best
    effect = next(one for one in solution.model.effects if one.name == best.effect.name)
    return effect, {
        f"{effect.name}.{p.name}": solution.parameters[f"{effect.name}.{p.name}"] for p in effect.inner
    }


def closest_forms(partial: PartiallyLinear, kind: Kind, kinds: Kinds, count: int = 2) -> list[str]:
    """Names of a kind's effects that take most beside laws of the other kinds, the best first.

    Args:
        partial: the base model beside flexible laws.
        kind: whose effects are compared.
        kinds: all kinds that account for the error.
        count: of names.
    """
    start = partial.search.start
    problem = partial.beside(frozenset({kind}), kinds, start.problem, start.solution)
    none = solve_gains(problem, start.solution.model, start.solution.parameters, rounds=2)
    library = applicable_effects(start.data, start.solution.model, partial.search.effects)
    effects = [effect for effect in library if kind in effect.also | {effect.kind}]
    tried = screen_effects(FitResult(start.data, problem, none), effects, refined=0) if effects else []
    telling = [one for one in tried if one.possible and one.held_out < (1.0 - SMALL) * none.held_out]
    return [candidate.effect.name for candidate in telling[:count]]


def _with_law(problem: FitProblem, solution: Solution, columns: FloatArray) -> float:
    """Squared held-out error with a flexible law beside a model."""
    if columns.shape[1] == 0:
        return solution.held_out
    equations = problem.normal_equations(np.hstack([solution.columns, columns]), solution.target)
    own = solution.columns.shape[1]
    ridges = np.array([[_COLLINEAR] * own + [ridge] * columns.shape[1] for ridge in _RIDGES])
    return min(float(held_out_sse(equations, ridges).sum(axis=1).min()), solution.held_out)


def form_tests(partial: PartiallyLinear, end: FitResult, kinds: Kinds = frozenset()) -> list[FormTest]:
    """Compare each effect of a model with its kind's flexible law, beside the others and laws of their kinds.

    Args:
        partial: the kinds that account for the base model's error, on the same blocks.
        end: base model and effects.
        kinds: further kinds whose laws stand beside each effect.
    """
    base = {effect.name for effect in partial.search.model.effects}
    added = [effect for effect in end.solution.model.effects if effect.name not in base]
    own = [effect for effect in added if not isinstance(effect, RunVariation)]
    kinds = partial.kinds | kinds | {effect.kind for effect in own}
    if len(own) < len(added):
        kinds -= {Kind.RUN_DIFFERENCES}  # the model has an effect for them
    tests = []
    for effect in own:
        beside_all = _form_test(partial, end, effect, kinds)
        # A law of a kind that no effect of the model belongs to may stand in for this effect.
        beside_named = _form_test(partial, end, effect, frozenset(other.kind for other in own))
        test = max(beside_all, beside_named, key=lambda test: test.share)
        tests.append(replace(test, left_by_all=beside_all.left))
    tests += [_run_test(partial, end, kinds, e.name) for e in added if isinstance(e, RunVariation)]
    return tests


def _form_test(partial: PartiallyLinear, end: FitResult, effect: Effect, kinds: Kinds) -> FormTest:
    """Compare one effect with the flexible law of its kind, beside laws of these other kinds."""
    model, known = end.solution.model, end.solution.parameters
    own = effect.also | {effect.kind}
    problem = partial.beside(own, kinds, end.problem, end.solution)
    with_it = solve_gains(problem, model, known, rounds=2)
    without = solve_gains(problem, model.without(effect.name), known, rounds=2)
    columns = partial.law_columns(own, kinds)
    law, both = _with_law(problem, without, columns), _with_law(problem, with_it, columns)
    count = max(int(end.problem.used.sum()), 1)
    # A law is fitted without the run that judges it, and so must be all parameters of an effect.
    left = held_out_of_all(problem, with_it)
    taken = held_out_of_all(problem, without) - left
    by_law = max(without.held_out - law, without.held_out - both, taken)
    return FormTest(
        effect.name,
        effect.kind,
        taken / count,
        by_law / count,
        (with_it.held_out - both) / count,
        left / count,
    )


def _run_test(partial: PartiallyLinear, end: FitResult, kinds: Kinds, name: str) -> FormTest:
    """Compare an effect that differs between runs with a gain and a zero of each, beside flexible laws."""
    own = frozenset({Kind.RUN_DIFFERENCES})
    model, known = end.solution.model, end.solution.parameters
    problem = partial.beside(own, kinds, end.problem, end.solution)
    with_it = solve_gains(problem, model, known, rounds=2).held_out
    without = solve_gains(problem, model.without(name), known, rounds=2).held_out
    of_each = partial.beside(frozenset(), kinds | own, end.problem, end.solution)
    law = solve_gains(of_each, model.without(name), known, rounds=2).held_out
    count = max(int(end.problem.used.sum()), 1)
    taken = (without - with_it) / count
    return FormTest(
        name, Kind.RUN_DIFFERENCES, taken, max((without - law) / count, taken), 0.0, with_it / count
    )


@dataclass
class NamedError(SquaredErrors):
    """Squared errors of a model reduced to its effects of some kinds."""

    end: FitResult
    named: Mapping[str, Kind]  # kind of each added effect

    def __post_init__(self) -> None:
        """Number the runs of the blocks that count."""
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
        solution = solve_gains(problem, model.without(*without), self.end.solution.parameters, rounds=2)
        gains = solution.linear_fit.fold_gains[problem.blocked.fold]
        left: FloatArray = solution.target - np.sum(solution.columns * gains, axis=1)
        return left[problem.used]
