"""Shares of a base model's held-out error, by kind of effect.

The share of a kind is its Shapley value within the smallest set of kinds that explains the error (R. H.
Lindeman, P. F. Merenda, R. Z. Gold 1980; U. Groemping, J. Stat. Softw. 17 (2006)). The average covers only
orders in which differences between runs come last, because a gain and a zero fitted to each run can imitate
much of any law (asymmetric Shapley values; C. Frye, C. Rowat, I. Feige, NeurIPS 33 (2020)). Two more figures
are the share that is lost without the kind (necessary) and the share that it explains alone (sufficient).
"""

from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np

from palpate.estimation.budget.held_out import Kinds, SquaredErrors
from palpate.estimation.kinds import Kind
from palpate.robot_io.types import FloatArray

_MIN_SHARE = 0.02  # least share of the squared error that a relevant kind explains, alone or with others
_MAX_KINDS = 6  # relevant kinds, which are compared in all combinations
_MAX_NAMED = 4  # kinds in the smallest set
# Error that the smallest set may leave beyond the best set's error: shares of the explainable error, and of
# the best set's error.
_ALLOWANCE, _ERROR_ALLOWANCE = 0.05, 0.03
_THOROUGH = 1.1  # largest mean squared error of a set that explains nearly all, relative to the smallest
_REPLACEMENT = 0.75  # least share of a kind's contribution, after the others, that a replacement explains
_SAMPLES = 200  # bootstrap samples of runs, for intervals

# If several sets explain as much, effects of the object and the drive come before those of the sensor.
_ORDER = tuple(Kind)


@dataclass(frozen=True)
class BudgetEntry:
    """Shares of the base model's squared held-out error that one kind accounts for."""

    kind: Kind
    share: float  # asymmetric Shapley value among the kinds of the smallest set
    interval: tuple[float, float]  # 95 % interval, from resampled runs
    necessary: float  # share lost without it, if all other kinds remain
    sufficient: float  # share explained by the kind alone
    replaceable_by: tuple[Kind, ...]  # kinds that explain about as much in its place


@dataclass(frozen=True)
class ErrorBudget:
    """Division of the base model's squared held-out error among kinds; shares and the rest add up to 1."""

    base: float  # root mean square held-out error of the base model, over blocks [effort]
    entries: tuple[BudgetEntry, ...]  # in descending order of the share
    unexplained: float  # share that these kinds do not explain
    unexplained_by_all: float  # share that all kinds together do not explain
    alternatives: tuple[Kinds, ...] = ()  # other sets of as few kinds that explain about as much
    sufficient_kinds: Kinds = frozenset()  # the smallest set that explains about as much as all kinds

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds that account for the error, the largest first."""
        return tuple(entry.kind for entry in self.entries)


def error_budget(error: SquaredErrors, rng: np.random.Generator, only: Kinds | None = None) -> ErrorBudget:
    """Divide the base model's held-out error among the kinds of effects that explain any of it.

    Args:
        error: held-out errors of sets of kinds.
        rng: resamples runs for the intervals.
        only: kinds among which the error is divided; None to select them.
    """
    base = error.mean_square()
    if base <= 0.0:
        return ErrorBudget(0.0, (), 1.0, 1.0)
    all_kinds = frozenset(error.kinds)
    known = frozenset[Kind]() if only is None else only & all_kinds
    sets = _KindSubsets(error, _relevant(error, all_kinds) | known)
    smallest = sets.smallest_sufficient(sets.limit) if only is None else [known]
    thorough = sets.smallest_sufficient(_THOROUGH * sets.best_mean_square(sets.relevant))[0]
    chosen = smallest[0]
    values = _shapley(sets, chosen, error.counts[:, None])[0]
    weights = rng.multinomial(error.runs, np.full(error.runs, 1.0 / error.runs), size=_SAMPLES).T.astype(
        np.float64
    )
    samples = _shapley(sets, chosen, error.counts[:, None], weights) if error.runs > 1 else values[None]
    low, high = np.quantile(samples, [0.025, 0.975], axis=0)
    least_error = min(error.mean_square(all_kinds), sets.best_mean_square(sets.relevant))
    entries = []
    for index, kind in enumerate(_ordered(chosen)):
        without = min(error.mean_square(all_kinds - {kind}), sets.best_mean_square(sets.relevant - {kind}))
        entries.append(
            BudgetEntry(
                kind,
                float(values[index]),
                (float(low[index]), float(high[index])),
                necessary=max(without - least_error, 0.0) / base,
                sufficient=max(base - sets.best_mean_square(frozenset({kind})), 0.0) / base,
                replaceable_by=sets.replacements(chosen, kind),
            )
        )
    entries.sort(key=lambda entry: -entry.share)
    left, flexible, rms = sets.best_mean_square(chosen) / base, least_error / base, float(np.sqrt(base))
    return ErrorBudget(rms, tuple(entries), left, flexible, tuple(smallest[1:]), thorough)


def _ordered(kinds: Kinds) -> list[Kind]:
    return sorted(kinds, key=_ORDER.index)


def _relevant(error: SquaredErrors, all_kinds: Kinds) -> Kinds:
    """Select kinds that explain a share of the error alone, after all others, or in forward selection."""
    base, least_error = error.mean_square(), error.mean_square(all_kinds)
    sufficient = {kind: (base - error.mean_square(frozenset({kind}))) / base for kind in all_kinds}
    necessary = {kind: (error.mean_square(all_kinds - {kind}) - least_error) / base for kind in all_kinds}
    chosen: Kinds = frozenset()
    left = base
    while all_kinds - chosen and len(chosen) < _MAX_KINDS:
        step, kind = min((error.mean_square(chosen | {k}), _ORDER.index(k)) for k in all_kinds - chosen)
        if left - step < _MIN_SHARE * base and step > (1.0 - 5.0 * _MIN_SHARE) * left:
            break
        chosen, left = chosen | {_ORDER[kind]}, step
    others = sorted(all_kinds - chosen, key=lambda kind: -(sufficient[kind] + max(necessary[kind], 0.0)))
    relevant = [kind for kind in others if max(sufficient[kind], necessary[kind]) > _MIN_SHARE]
    return chosen | frozenset(relevant[: max(_MAX_KINDS - len(chosen), 0)])


@dataclass(frozen=True)
class _KindSubsets:
    """Errors of all sets of relevant kinds; the error of a set is the error of its best subset."""

    error: SquaredErrors
    relevant: Kinds

    def by_run(self, kinds: Kinds) -> FloatArray:
        """Return each run's sum of squared errors for the best subset of some kinds, shape (r,) [effort^2].

        Args:
            kinds: set whose subsets, with the empty one, are compared by their sum over all runs.
        """
        subsets = [
            frozenset(part) for size in range(len(kinds) + 1) for part in combinations(_ordered(kinds), size)
        ]
        return min(map(self.error.by_run, subsets), key=lambda squares: float(squares.sum()))

    def best_mean_square(self, kinds: Kinds) -> float:
        """Return the mean squared error of the best subset of some kinds, over all blocks [effort^2].

        Args:
            kinds: set of kinds; its error is never larger than that of one of its subsets.
        """
        return float(self.by_run(kinds).sum() / self.error.counts.sum())

    @property
    def limit(self) -> float:
        """Mean squared error up to which a set explains about as much as all kinds do [effort^2]."""
        base, best = self.error.mean_square(), self.best_mean_square(self.relevant)
        return best + _ALLOWANCE * (base - best) + _ERROR_ALLOWANCE * best

    def smallest_sufficient(self, limit: float) -> list[Kinds]:
        """Find the smallest sets with an error within a limit, those without run differences first.

        If there is none, the best set of the largest size is returned.

        Args:
            limit: largest mean squared error of a set [effort^2].

        Returns:
            Sets of equal size; only the empty set if the base model's error is within the limit.
        """
        if self.error.mean_square() <= limit:
            return [frozenset()]
        max_size = min(_MAX_NAMED, len(self.relevant))
        for size in range(1, max_size + 1):
            sets = [frozenset(kinds) for kinds in combinations(_ordered(self.relevant), size)]
            close = [kinds for kinds in sets if self.error.mean_square(kinds) <= limit]
            if close or size == max_size:
                close.sort(key=lambda kinds: (Kind.RUN_DIFFERENCES in kinds, self.error.mean_square(kinds)))
                return close or [min(sets, key=self.best_mean_square)]
        return [frozenset()]

    def replacements(self, chosen: Kinds, kind: Kind) -> tuple[Kind, ...]:
        """Find kinds that explain about as much in the place of a kind, with the other chosen kinds.

        Args:
            chosen: kinds among which the error is divided.
            kind: the one of them to replace.
        """
        kept = chosen - {kind}
        without, with_it = self.best_mean_square(kept), self.best_mean_square(chosen)
        limit = without - _REPLACEMENT * (without - with_it)
        others = _ordered(self.relevant - chosen)
        return tuple(other for other in others if self.best_mean_square(kept | {other}) <= limit)


def _shapley(
    sets: _KindSubsets, chosen: Kinds, counts: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """Compute asymmetric Shapley values (samples, k): shares of the error, differences between runs last."""
    ordered = _ordered(chosen)
    weights = np.ones((len(counts), 1)) if weights is None else weights

    def value(kinds: Kinds) -> FloatArray:
        return np.asarray(sets.by_run(kinds) @ weights)

    base = np.maximum(value(frozenset()), 1e-300)
    values = np.zeros((weights.shape[1], len(ordered)))
    for index, kind in enumerate(ordered):
        if kind is Kind.RUN_DIFFERENCES:
            values[:, index] = (value(chosen - {kind}) - value(chosen)) / base
            continue
        others = [name for name in ordered if name not in {kind, Kind.RUN_DIFFERENCES}]
        for size in range(len(others) + 1):
            weight = factorial(size) * factorial(len(others) - size) / factorial(len(others) + 1)
            for preceding in combinations(others, size):
                before = frozenset(preceding)
                values[:, index] += weight * (value(before) - value(before | {kind})) / base
    return values
