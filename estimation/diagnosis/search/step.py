"""An effect that was accepted, and the test of several together: each must be needed beside all others."""

from collections.abc import Sequence
from dataclasses import dataclass

from estimation.fit.standing import Standing
from estimation.diagnosis.search.evidence import Evidence, evidence, is_slight
from estimation.diagnosis.search.possible import is_possible
from estimation.diagnosis.search.search import Search


@dataclass(frozen=True)
class Step:
    """One effect accepted.

    Attributes:
        effect: its name.
        evidence: what spoke for it.
        standing: where things stood with it.
    """

    effect: str
    evidence: Evidence
    standing: Standing


def confirmed(search: Search, end: Standing, names: Sequence[str]) -> tuple[Step, ...] | None:
    """Steps to `end`, the most telling effect first; None if one of them is not needed.

    An effect may explain little until another is there as well, so each is weighed beside all the others.

    Args:
        search: what was tried so far.
        end: the base model with all of `names`.
        names: the effects in question.
    """
    weighed = {name: _needed(search, end, name) for name in names}
    steps: list[Step] = []
    standing = end
    for count in range(len(names), 0, -1):
        left = {name: search.without(standing, name) for name in names if name in _names(standing)}
        least = max(left, key=lambda name: -left[name].trial.held_out) if count > 1 else next(iter(left))
        found = weighed[least]
        if found is None:
            return None
        steps.insert(0, Step(least, found, standing))
        standing = left[least]
    return tuple(steps)


def _names(standing: Standing) -> set[str]:
    return {effect.name for effect in standing.trial.model.effects}


def _needed(search: Search, end: Standing, name: str) -> Evidence | None:
    """What speaks for an effect beside all others; None if that is not enough."""
    before = search.without(end, name)
    found = search.screen(before)
    chosen = next((c for c in found if c.effect.name == name), None)
    if chosen is None or is_slight(search.start, before, end.trial.held_out):
        return None
    weighed = evidence(before, end, found, chosen, search.rng)
    return weighed if weighed.enough and is_possible(chosen.effect, end.trial, end.plain) else None
