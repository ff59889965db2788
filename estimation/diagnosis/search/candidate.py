"""An effect that was tried beside a model, and which of those tried are worth weighing."""

from collections.abc import Sequence
from dataclasses import dataclass

from estimation.fit.inner_search import Attempts
from estimation.fit.standing import Standing
from estimation.effect import Effect

TRIES = 3  # candidates weighed before giving up
MOST = 0.95  # of what the best candidate takes away; a simpler one that does as much comes first
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
    search: Attempts
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
