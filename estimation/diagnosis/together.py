"""Two effects that are found only together: one of them alone explains little, or the wrong one does more."""

from collections.abc import Iterator

from estimation.diagnosis.confusion import likeness
from estimation.diagnosis.search import Search
from estimation.diagnosis.selection import LEFT_AT_FIRST, TIE, Candidate
from estimation.diagnosis.standing import Standing
from estimation.diagnosis.step import Step, confirmed

FIRST, SECOND = 5, 2  # candidates that are tried beside the base model, and beside each of these
ALIKE = 0.9  # cosine between what two candidates explain, above which the second is not tried as well


def pair(search: Search) -> tuple[Step, ...] | None:
    """The simplest pair of effects that explains all and in which each is needed, or None."""
    complete = sorted(_complete(search), key=lambda found: found[2].trial.held_out)
    if not complete:
        return None
    limit = (1.0 + TIE) * complete[0][2].trial.held_out
    close = [found for found in complete if found[2].trial.held_out <= limit]
    for one, other, end in sorted(close, key=lambda found: found[0].size + found[1].size):
        steps = confirmed(search, end, [one.effect.name, other.effect.name])
        if steps:
            return steps
    return None


def _complete(search: Search) -> Iterator[tuple[Candidate, Candidate, Standing]]:
    """Pairs that leave no more than noise."""
    for one in _different(search):
        beside = search.with_candidate(one)
        for number, other in enumerate(search.screen(beside)[:SECOND]):
            # until both are fitted together, the first may be far off
            if number > 0 and other.held_out > LEFT_AT_FIRST * search.floor:
                continue
            end = search.with_candidate(other)
            if search.is_explained(end):
                yield one, other, end


def _different(search: Search) -> list[Candidate]:
    """The best candidates beside the base model that do not explain the same."""
    base, chosen = search.start.trial, list[Candidate]()
    for one in search.screen(search.start):
        if all(likeness(base, one.search.best, other.search.best) < ALIKE for other in chosen):
            chosen.append(one)
        if len(chosen) == FIRST:
            break
    return chosen
