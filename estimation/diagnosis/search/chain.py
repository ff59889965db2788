"""Adds one effect after the other, and looks back at each step whether another would serve better."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.fit.exact import is_exact
from estimation.fit.standing import Standing
from estimation.diagnosis.search.candidate import TIE, TRIES, Candidate, choose, close_to_best, size
from estimation.diagnosis.search.credible import is_misnamed, may_be_nothing
from estimation.diagnosis.search.dominant import is_dominant, simplest
from estimation.diagnosis.search.evidence import Evidence, evidence, hopeless, is_slight
from estimation.diagnosis.search.nameless import is_late_otherwise, is_outdone
from estimation.diagnosis.search.possible import LEAST_GAIN, is_possible
from estimation.diagnosis.search.search import Search
from estimation.diagnosis.search.step import Step, confirmed
from estimation.diagnosis.search.together import pair
from estimation.effect import Effect

MOST_EFFECTS = 3  # with more, almost anything can be imitated
EQUAL = 1.2  # times the held-out energy of a candidate, up to which another of its size may be the better one
MODEST = 4  # parameters added, up to which nothing simpler is looked for


@dataclass(frozen=True)
class Chain:
    """All that was accepted, in order.

    Attributes:
        start: the base model alone.
        steps: one for each effect accepted.
        ranking: all candidates beside the base model, best first.
        refused: the candidate that came next, and why it was not taken; None if there was none.
        floor: energy on blocks of held-out runs that no smooth law explains beside any model tried.
        is_complete: whether no more than noise is left at the end.
        dominant: the one effect that can be named though the steps do not complete the model, if any.
        doubted: whether the steps leave no more than noise, but are not what their names say.
    """

    start: Standing
    steps: tuple[Step, ...]
    ranking: tuple[Candidate, ...]
    refused: "Refusal | None"
    floor: float
    is_complete: bool
    dominant: Step | None = None
    doubted: bool = False

    @property
    def end(self) -> Standing:
        """Where things stand with all that was accepted."""
        return self.steps[-1].standing if self.steps else self.start

    @property
    def named(self) -> tuple[Step, ...]:
        """The steps that can be called by their names."""
        if self.is_complete:
            return self.steps
        return (self.dominant,) if self.dominant else ()


Refusal = tuple[Candidate, Evidence]


def build(search: Search) -> Chain:
    """Accept effects one after the other until no further one is worth it, or else two at once."""
    start = search.start
    ranking: tuple[Candidate, ...] = ()
    steps: tuple[Step, ...] = ()
    refused = None
    while len(steps) < MOST_EFFECTS:
        before = steps[-1].standing if steps else start
        found = search.screen(before)
        ranking = ranking or tuple(found)
        if is_exact(before):
            break
        step, refused = _next(search, before, found)
        if step is None:
            break
        steps = _settled(search, _reconsider(search, (*steps, step)))
    if len(steps) > 1 or not search.is_explained(steps[-1].standing if steps else start):
        steps = _better(search, steps, _alone(search, ranking))
    if not search.is_explained(steps[-1].standing if steps else start) or _size(search, steps) > MODEST:
        steps = _better(search, steps, pair(search))
    steps = _without_what_may_be_nothing(search, steps)
    end = steps[-1].standing if steps else start
    complete = search.is_explained(end) and not any(_is_empty(search, end, step.effect) for step in steps)
    doubted = not complete and search.leaves_noise(end)
    chain = Chain(start, steps, ranking, refused, search.floor, complete, doubted=doubted)
    return chain if complete or not steps else replace(chain, dominant=_dominant(search, chain))


def _without_what_may_be_nothing(search: Search, steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """The steps less those that only led the others to where they explain all by themselves."""
    for name in [step.effect for step in steps] if len(steps) > 1 else ():
        end, rest = steps[-1].standing, [step.effect for step in steps if step.effect != name]
        if not rest or not search.is_explained(end) or not may_be_nothing(_effect(end, name), end):
            continue
        trial = end.trial
        alone = search.stand_anew(trial.model.without(name), trial.parameters)
        steps = (confirmed(search, alone, rest) if search.is_explained(alone) else None) or steps
    return steps


def _effect(standing: Standing, name: str) -> Effect:
    return next(one for one in standing.trial.model.effects if one.name == name)


def _is_empty(search: Search, end: Standing, name: str) -> bool:
    """Whether one effect may be nothing, or a law that nobody has named serves better in its place."""
    effect = _effect(end, name)
    if may_be_nothing(effect, end) or is_late_otherwise(end, effect):
        return True
    without = search.without(end, name)
    return is_outdone(without, end, search.tried(without))


def _settled(search: Search, steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """The same effects, where each had settled before the others were there and something is left."""
    names = [step.effect for step in steps]
    for name in names if len(names) > 1 else ():
        if search.is_explained(steps[-1].standing):
            break
        again = search.elsewhere(steps[-1].standing, name)
        if again.trial.held_out < (1.0 - TIE) * steps[-1].standing.trial.held_out:
            steps = confirmed(search, again, names) or steps
    return steps


def _alone(search: Search, found: Sequence[Candidate]) -> tuple[Step, ...] | None:
    """The one effect that explains all, where a simpler one that draws most of it led astray."""
    for candidate in close_to_best(search.start, found) if found else ():
        after = search.with_candidate(candidate)
        steps = confirmed(search, after, [candidate.effect.name]) if search.is_explained(after) else None
        if steps:
            return steps
    return None


def _better(search: Search, steps: tuple[Step, ...], other: tuple[Step, ...] | None) -> tuple[Step, ...]:
    """Others that explain all instead of the steps, if these do not, or need more parameters for it."""
    if other is None or not steps or not search.is_explained(steps[-1].standing):
        return other or steps
    as_good = other[-1].standing.trial.held_out < (1.0 + TIE) * steps[-1].standing.trial.held_out
    return other if as_good and _size(search, other) < _size(search, steps) else steps


def _size(search: Search, steps: tuple[Step, ...]) -> int:
    """Number of parameters that the steps added."""
    names = {step.effect for step in steps}
    return sum(size(effect) for effect in search.effects if effect.name in names)


def _dominant(search: Search, chain: Chain) -> Step | None:
    """The simplest effect of the law that dominates, if there is one."""
    start, found = chain.start, chain.ranking
    for candidate in close_to_best(start, found):
        after = search.with_candidate(candidate)
        if not is_possible(candidate.effect, after.trial, after.plain):
            continue
        if is_misnamed(candidate.effect, after.trial, after.plain):
            continue
        if is_outdone(start, after, search.tried(start)):
            continue
        if is_dominant(start, after, candidate, search.tried(start), chain.floor):
            named = simplest(candidate, found, start)
            standing = search.with_candidate(named)
            weighed = evidence(start, standing, found, named, search.rng)
            return Step(named.effect.name, weighed, standing) if weighed.enough else None
    return None


def _next(search: Search, before: Standing, found: list[Candidate]) -> tuple[Step | None, Refusal | None]:
    """The first candidate with enough evidence, or the first that was refused.

    One that has become another thing than its name says gives way to one that does nearly as well.
    """
    refused, misnamed = None, None
    for chosen in _in_order(search, before, found):
        if misnamed and chosen.held_out > EQUAL * misnamed.standing.trial.held_out:
            break
        slight = is_slight(search.start, before, chosen.held_out)
        if slight or chosen.held_out > (1.0 - LEAST_GAIN) ** 2 * before.trial.held_out:
            refused = refused or (chosen, hopeless(before, chosen))
            continue
        after = search.with_candidate(chosen)
        weighed = evidence(before, after, found, chosen, search.rng)
        if weighed.enough and is_possible(chosen.effect, after.trial, after.plain):
            step = Step(chosen.effect.name, weighed, after)
            if not is_misnamed(chosen.effect, after.trial, after.plain):
                return step, None
            misnamed = misnamed or step
            continue
        refused = refused or (chosen, weighed)
    return misnamed, refused


def _in_order(
    search: Search, before: Standing, found: list[Candidate], *, larger: bool = False
) -> list[Candidate]:
    """The candidates worth weighing; of those about as good as the first, the one that fits best comes first.

    They were tried beside the model as it was: once all is fitted together, another may be better.

    Args:
        search: what was tried so far.
        before: the model without any of them.
        found: all that were tried beside it.
        larger: whether the better one may have more parameters.
    """
    if not found:
        return []
    first, *others = choose(before, found)
    near = [c for c in found if c is not first and c.held_out <= EQUAL * first.held_out]
    near = [first, *[c for c in near if larger or c.size == first.size][: TRIES - 1]]
    left = [search.with_candidate(c).trial.held_out for c in near] if len(near) > 1 else [0.0]
    as_good = [c for c, energy in zip(near, left, strict=True) if energy <= (1.0 + TIE) * min(left)]
    best = min(as_good, key=lambda c: c.size)
    return [best, *(c for c in (first, *others) if c is not best)]


def _reconsider(search: Search, steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """Drop what the later effects made needless, and exchange what another would now do better.

    What is put in the place of the old steps must hold against chance as they did.
    """
    for name in [step.effect for step in steps[:-1]]:
        end = steps[-1].standing
        others = [step.effect for step in steps if step.effect != name]
        without = search.without(end, name)
        if without.trial.held_out * (1.0 - LEAST_GAIN) ** 2 < end.trial.held_out:
            steps = confirmed(search, without, others) or steps
            continue
        in_order = _in_order(search, without, search.screen(without), larger=True)
        best = in_order[0] if in_order else None
        if best:  # it may be the same, that had settled elsewhere before the later ones were there
            exchanged = search.with_candidate(best)
            simpler = any(best.size < size(effect) for effect in search.effects if effect.name == name)
            if exchanged.trial.held_out < (1.0 + (TIE if simpler else -TIE)) * end.trial.held_out:
                steps = confirmed(search, exchanged, [*others, best.effect.name]) or steps
    return steps
