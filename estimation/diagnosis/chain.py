"""Adds one effect after the other, and looks back at each step whether another would serve better."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.channel import ChannelData
from estimation.diagnosis.dominant import is_dominant, simplest
from estimation.diagnosis.library import candidates
from estimation.diagnosis.selection import (
    LEAST_GAIN,
    TIE,
    Candidate,
    Evidence,
    choose,
    close_to_best,
    evidence,
    hopeless,
    is_possible,
    screen,
)
from estimation.diagnosis.standing import Standing, stand
from estimation.diagnosis.unexplained import is_explained
from estimation.effect import Effect
from estimation.model import Model
from robot_io.types import BoolArray

MOST_EFFECTS = 3  # with more, almost anything can be imitated
DONE = 0.005  # share of the error that may be left for the search to end: no candidate can take more
Progress = Callable[[str, float], None]


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


@dataclass(frozen=True)
class Chain:
    """All that was accepted, in order.

    Attributes:
        start: the base model alone.
        steps: one for each effect accepted.
        ranking: all candidates beside the base model, best first.
        refused: the candidate that came next, and why it was not taken; None if there was none.
        dominant: the one effect that can be named though the steps do not complete the model, if any.
    """

    start: Standing
    steps: tuple[Step, ...]
    ranking: tuple[Candidate, ...]
    refused: "Refusal | None"
    dominant: Step | None = None

    @property
    def end(self) -> Standing:
        """Where things stand with all that was accepted."""
        return self.steps[-1].standing if self.steps else self.start

    @property
    def is_complete(self) -> bool:
        """Whether no more than noise is left at the end."""
        return is_explained(self.end)

    @property
    def named(self) -> tuple[Step, ...]:
        """The steps that can be called by their names."""
        if self.is_complete:
            return self.steps
        return (self.dominant,) if self.dominant else ()

    @property
    def floor(self) -> float:
        """Energy on blocks of held-out runs that no smooth law explains, at best."""
        standings = [self.start, *(step.standing for step in self.steps)]
        return min(float(standing.flexible.held_out.sum()) for standing in standings)


@dataclass(frozen=True)
class Search:
    """What a search for effects works on; what it has once fitted or tried, it remembers.

    Attributes:
        data: the channel.
        model: the base model.
        good: samples that are fit for use, shape (n,).
        effects: the library.
        rng: for surrogates.
        progress: told what is being done, and the share of it that is done.
    """

    data: ChannelData
    model: Model
    good: BoolArray
    effects: tuple[Effect, ...]
    rng: np.random.Generator
    progress: Progress
    _standings: dict[frozenset[str], Standing] = field(default_factory=dict)
    _screened: dict[frozenset[str], list[Candidate]] = field(default_factory=dict)

    def screen(self, standing: Standing) -> list[Candidate]:
        """All candidates beside the model of `standing`."""
        model = standing.trial.model
        key = frozenset(effect.name for effect in model.effects)
        if key not in self._screened:
            tried = candidates(standing.data, model, self.effects)
            what = f"{self.data.name}: beside {', '.join(e.name for e in model.effects)}"
            self._screened[key] = screen(
                standing, model, tried, lambda share, name: self.progress(f"{what}: {name}", share)
            )
        return self._screened[key]

    def stand(self, names: Sequence[str], parameters: Mapping[str, float]) -> Standing:
        """The base model with these effects, fitted from these parameters on."""
        key = frozenset(names)
        if key not in self._standings:
            by_name = {effect.name: effect for effect in self.effects}
            model = replace(self.model, effects=(*self.model.effects, *(by_name[name] for name in names)))
            self._standings[key] = stand(self.data, model, parameters, self.good)
        return self._standings[key]


def build(search: Search) -> Chain:
    """Accept effects until no further one is worth it."""
    start = search.stand([], {})
    ranking: tuple[Candidate, ...] = ()
    steps: tuple[Step, ...] = ()
    refused = None
    while len(steps) < MOST_EFFECTS:
        before = steps[-1].standing if steps else start
        if steps and before.left <= DONE:
            break
        found = search.screen(before)
        ranking = ranking or tuple(found)
        step, refused = _next(search, before, found, [step.effect for step in steps])
        if step is None:
            break
        steps = _reconsider(search, start, (*steps, step))
    chain = Chain(start, steps, ranking, refused)
    return chain if chain.is_complete or not steps else replace(chain, dominant=_dominant(search, chain))


Refusal = tuple[Candidate, Evidence]


def _dominant(search: Search, chain: Chain) -> Step | None:
    """The simplest effect of the law that dominates, if there is one."""
    start, found = chain.start, chain.ranking
    for candidate in close_to_best(start, found):
        after = search.stand([candidate.effect.name], candidate.search.best.parameters)
        if is_dominant(start, after, candidate, found, chain.floor):
            named = simplest(candidate, found, start)
            standing = search.stand([named.effect.name], named.search.best.parameters)
            weighed = evidence(start, standing, found, named, search.rng)
            return Step(named.effect.name, weighed, standing) if weighed.enough else None
    return None


def _next(
    search: Search, before: Standing, found: Sequence[Candidate], names: Sequence[str]
) -> tuple[Step | None, Refusal | None]:
    """The first candidate with enough evidence, or the first that was refused."""
    refused = None
    for chosen in choose(before, found) if found else []:
        if chosen.held_out > (1.0 - LEAST_GAIN) ** 2 * before.trial.held_out:
            refused = refused or (chosen, hopeless(before, chosen))
            continue
        after = search.stand([*names, chosen.effect.name], chosen.search.best.parameters)
        weighed = evidence(before, after, found, chosen, search.rng)
        if weighed.enough and is_possible(chosen.effect, after.trial, after.plain):
            return Step(chosen.effect.name, weighed, after), None
        refused = refused or (chosen, weighed)
    return None, refused


def _reconsider(search: Search, start: Standing, steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """Drop what the later effects made needless, and exchange what another would now do better.

    What is put in the place of the old steps must hold against chance as they did.
    """
    for name in [step.effect for step in steps[:-1]]:
        end = steps[-1].standing
        others = [step.effect for step in steps if step.effect != name]
        without = search.stand(others, end.trial.parameters)
        if without.trial.held_out * (1.0 - LEAST_GAIN) ** 2 < end.trial.held_out:
            steps = _redo(search, start, others, without) or steps
            continue
        best = choose(without, search.screen(without))[0]
        if best.effect.name != name:
            exchanged = search.stand([*others, best.effect.name], best.search.best.parameters)
            if exchanged.trial.held_out < (1.0 - TIE) * end.trial.held_out:
                steps = _redo(search, start, [*others, best.effect.name], exchanged) or steps
    return steps


def _redo(search: Search, start: Standing, names: Sequence[str], end: Standing) -> tuple[Step, ...] | None:
    """Steps to `end` in this order, each weighed against chance; None if one of them does not hold."""
    steps: list[Step] = []
    before = start
    for count, name in enumerate(names, start=1):
        found = search.screen(before)
        chosen = next((c for c in found if c.effect.name == name), None)
        if chosen is None:
            return None
        after = end if count == len(names) else search.stand(names[:count], chosen.search.best.parameters)
        weighed = evidence(before, after, found, chosen, search.rng)
        if not (weighed.enough and is_possible(chosen.effect, after.trial, after.plain)):
            return None
        steps.append(Step(name, weighed, after))
        before = after
    return tuple(steps)
