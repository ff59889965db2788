"""Shares of a base model's held-out error, by kind of effect.

The share of a kind is its Shapley value among the kinds that together explain the error with as few kinds
as possible (R. H. Lindeman, P. F. Merenda, R. Z. Gold 1980; U. Groemping, J. Stat. Softw. 17 (2006)). Its
range goes from what is lost when the kind is left out of all (necessary) to what it explains alone
(sufficient).
"""

from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np

from palpate.estimation.budget.held_out import Kinds, SquaredErrors
from palpate.estimation.kinds import Kind
from palpate.robot_io.types import FloatArray

_TELLING = (
    0.02  # of the base model's squared error: a kind that explains less alone and beside all is left out
)
_MOST_KINDS = 6  # that are compared in all combinations
_MOST_NAMED = 4  # in the smallest set
_CLOSE = 0.05  # of what can be explained, by which the smallest set may miss the best
_CLOSE_TO_LEFT = 0.03  # of what is left by the best
_THOROUGH = 1.1  # times the least mean squared error
_STANDS_IN = 0.75  # of what a kind takes beside the others, from which another may replace it
_DRAWS = 200  # of runs, for intervals

# Where several sets explain as much: what the object and the drive do comes before what the reader does.
_PLAUSIBLE = tuple(Kind)


@dataclass(frozen=True)
class BudgetEntry:
    """What one kind accounts for, as shares of the base model's squared held-out error."""

    kind: Kind
    share: float  # Shapley value among the kinds of the smallest set
    interval: tuple[float, float]  # 95 %, over runs
    necessary: float  # lost when it is left out of all kinds
    sufficient: float  # explained by it alone
    replaceable_by: tuple[Kind, ...]  # kinds that explain about as much in its place


@dataclass(frozen=True)
class ErrorBudget:
    """How a base model's squared held-out error divides among kinds; the shares and `left` add up to 1."""

    base: float  # root mean squared held-out error of the base model, on blocks [effort]
    entries: tuple[BudgetEntry, ...]  # the largest share first
    left: float  # share that these kinds leave
    flexible: float  # share that all kinds together leave
    alternatives: tuple[Kinds, ...] = ()  # further sets of as few kinds that explain about as much
    thorough: Kinds = frozenset()  # the smallest set that leaves about as little as all kinds do

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds that account for the error, the largest first."""
        return tuple(entry.kind for entry in self.entries)


def error_budget(error: SquaredErrors, rng: np.random.Generator, only: Kinds | None = None) -> ErrorBudget:
    """Divide the base model's held-out error among the kinds of effects.

    Args:
        error: held-out errors of sets of kinds.
        rng: draws runs for the intervals.
        only: kinds that are known to be all; None to find them.

    Returns:
        The budget; without entries where no kind explains anything.
    """
    base = error.mean_square()
    if base <= 0.0:
        return ErrorBudget(0.0, (), 1.0, 1.0)
    every = frozenset(error.kinds)
    known = frozenset[Kind]() if only is None else only & every
    sets = _Sets(error, _relevant(error, every) | known)
    smallest = sets.smallest(sets.limit) if only is None else [only & every]
    thorough = sets.smallest(_THOROUGH * sets.least(sets.relevant))[0]
    chosen = smallest[0]
    values = _shapley(sets, chosen, error.counts[:, None])[0]
    weights = rng.multinomial(error.runs, np.full(error.runs, 1.0 / error.runs), size=_DRAWS).T.astype(
        np.float64
    )
    drawn = _shapley(sets, chosen, error.counts[:, None], weights) if error.runs > 1 else values[None]
    low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
    everything = min(error.mean_square(every), sets.least(sets.relevant))
    entries = []
    for place, kind in enumerate(_ordered(chosen)):
        without = min(error.mean_square(every - {kind}), sets.least(sets.relevant - {kind}))
        entries.append(
            BudgetEntry(
                kind,
                float(values[place]),
                (float(low[place]), float(high[place])),
                necessary=max(without - everything, 0.0) / base,
                sufficient=max(base - sets.least(frozenset({kind})), 0.0) / base,
                replaceable_by=sets.replacements(chosen, kind),
            )
        )
    entries.sort(key=lambda entry: -entry.share)
    left = sets.least(chosen) / base
    further = tuple(smallest[1:])
    return ErrorBudget(float(np.sqrt(base)), tuple(entries), left, everything / base, further, thorough)


def _ordered(kinds: Kinds) -> list[Kind]:
    return sorted(kinds, key=_PLAUSIBLE.index)


def _relevant(error: SquaredErrors, every: Kinds) -> Kinds:
    """Kinds that explain something alone, beside all others, or on the way of a forward selection."""
    base, everything = error.mean_square(), error.mean_square(every)
    alone = {kind: (base - error.mean_square(frozenset({kind}))) / base for kind in every}
    beside = {kind: (error.mean_square(every - {kind}) - everything) / base for kind in every}
    chosen: Kinds = frozenset()
    left = base
    while every - chosen and len(chosen) < _MOST_KINDS:
        step, kind = min((error.mean_square(chosen | {k}), _PLAUSIBLE.index(k)) for k in every - chosen)
        if left - step < _TELLING * base and step > (1.0 - 5.0 * _TELLING) * left:
            break
        chosen, left = chosen | {_PLAUSIBLE[kind]}, step
    rest = sorted(every - chosen, key=lambda kind: -(alone[kind] + max(beside[kind], 0.0)))
    telling = [kind for kind in rest if max(alone[kind], beside[kind]) > _TELLING]
    return chosen | frozenset(telling[: max(_MOST_KINDS - len(chosen), 0)])


@dataclass(frozen=True)
class _Sets:
    """Errors of all sets of the relevant kinds; a larger set never counts as worse than one it contains."""

    error: SquaredErrors
    relevant: Kinds

    def by_run(self, kinds: Kinds) -> FloatArray:
        """Squared errors of each run, shape (r,), of the best set within these kinds.

        Args:
            kinds: kinds whose laws may be used.
        """
        parts = [
            frozenset(some) for size in range(len(kinds) + 1) for some in combinations(_ordered(kinds), size)
        ]
        return min(map(self.error.by_run, parts), key=lambda squares: float(squares.sum()))

    def least(self, kinds: Kinds) -> float:
        """Mean squared error of the best set within these kinds.

        Args:
            kinds: kinds whose laws may be used.
        """
        return float(self.by_run(kinds).sum() / self.error.counts.sum())

    @property
    def limit(self) -> float:
        """Mean squared error up to which a set explains about as much as all kinds do."""
        base, best = self.error.mean_square(), self.least(self.relevant)
        return best + _CLOSE * (base - best) + _CLOSE_TO_LEFT * best

    def smallest(self, limit: float) -> list[Kinds]:
        """The smallest sets that leave no larger mean squared error than this, the best first.

        Laws that all runs have in common come before a gain and a zero of each run: these are more numbers.

        Args:
            limit: highest mean squared error [effort^2].
        """

        def rank(kinds: Kinds) -> tuple[bool, float]:
            return Kind.RUN_DIFFERENCES in kinds, self.error.mean_square(kinds)

        if self.error.mean_square() <= limit:
            return [frozenset()]
        most = min(_MOST_NAMED, len(self.relevant))
        for size in range(1, most + 1):
            some = [frozenset(kinds) for kinds in combinations(_ordered(self.relevant), size)]
            close = [kinds for kinds in some if self.error.mean_square(kinds) <= limit]
            if close or size == most:
                return sorted(close, key=rank) or [min(some, key=self.least)]
        return [frozenset()]

    def replacements(self, chosen: Kinds, kind: Kind) -> tuple[Kind, ...]:
        """Kinds in whose place this one explains hardly more, beside the rest of the chosen ones.

        Args:
            chosen: kinds that account for the error.
            kind: one of them.
        """
        rest = chosen - {kind}
        without, with_it = self.least(rest), self.least(chosen)
        limit = without - _STANDS_IN * (without - with_it)
        others = _ordered(self.relevant - chosen)
        return tuple(other for other in others if self.least(rest | {other}) <= limit)


def _shapley(sets: _Sets, chosen: Kinds, counts: FloatArray, weights: FloatArray | None = None) -> FloatArray:
    """Shapley values of the chosen kinds, shape (draws, k), as shares of the base model's squared error.

    Args:
        sets: errors of sets of kinds.
        chosen: k kinds.
        counts: blocks of each run, shape (r, 1).
        weights: how often each run was drawn, shape (r, draws); None for once each.
    """
    names = _ordered(chosen)
    weights = np.ones((len(counts), 1)) if weights is None else weights

    def value(kinds: Kinds) -> FloatArray:
        return np.asarray(sets.by_run(kinds) @ weights)

    base = np.maximum(value(frozenset()), 1e-300)
    values = np.zeros((weights.shape[1], len(names)))
    for place, kind in enumerate(names):
        others = [name for name in names if name != kind]
        for size in range(len(names)):
            weight = factorial(size) * factorial(len(names) - size - 1) / factorial(len(names))
            for some in combinations(others, size):
                before = frozenset(some)
                values[:, place] += weight * (value(before) - value(before | {kind})) / base
    return values
