"""All pairs of effects, tried on a coarse copy of the channel, where a model costs a fraction of the time.

Beside the wrong first effect the right second one explains little, so no pair is left out for how its first
does alone. What comes out is where to begin on the channel itself.
"""

from dataclasses import dataclass, replace
from functools import partial

from estimation.channel import ChannelData
from estimation.fit.frame import Frame
from estimation.fit.memory import Memory
from estimation.fit.standing import Fit, fit
from estimation.fit.trial import Trial
from estimation.diagnosis.search.candidate import TIE, Candidate
from estimation.diagnosis.search.library import candidates
from estimation.diagnosis.search.screening import screen
from estimation.diagnosis.search.search import Search
from estimation.effect import Effect
from robot_io.types import BoolArray

BESIDE = 4  # candidates that are looked at beside each
FITTED = 30  # pairs of which all parameters are fitted together
PROMISING = 1.3  # times the energy that the best pair leaves
MOST = 4


@dataclass(frozen=True)
class Pair:
    """Two effects beside the base model, and about where their parameters are.

    Attributes:
        one: the name of one effect.
        other: that of the other.
        size: number of their parameters.
        trial: the base model with both, on the coarse copy.
    """

    one: str
    other: str
    size: int
    trial: Trial

    @property
    def names(self) -> frozenset[str]:
        """Of the two."""
        return frozenset((self.one, self.other))

    @property
    def left(self) -> float:
        """Energy that is left in held-out runs."""
        return self.trial.held_out


def promising_pairs(search: Search) -> list[Pair]:
    """The pairs that leave least; of those that leave as little, the simplest first."""
    start = search.start
    coarse, good, memory = coarse_copy(start.plain.frame), start.plain.frame.trusted, Memory()
    base = fit(coarse, search.model, start.trial.parameters, good, memory)
    firsts = _screened(base, coarse, search.effects)

    def tell(number: int) -> None:
        search.progress(f"{coarse.name}: pairs with {firsts[number].effect.name}", number / len(firsts))

    work = partial(_beside, coarse, good, search.effects, memory)
    seconds = search.each(work, [one.search.best for one in firsts], tell)
    found = [(one, other) for one, others in zip(firsts, seconds, strict=True) for other in others]
    found.sort(key=lambda two: two[1].held_out)
    pairs: dict[frozenset[str], Pair] = {}
    for one, other in found[:FITTED]:
        best = other.search.best
        trial = fit(coarse, best.model, best.parameters, good, memory).trial
        pair = Pair(one.effect.name, other.effect.name, one.size + other.size, trial)
        pairs[pair.names] = min(pair, pairs.get(pair.names, pair), key=lambda one: one.left)
    least = min((pair.left for pair in pairs.values()), default=0.0)
    promising = [pair for pair in pairs.values() if pair.left <= PROMISING * least]
    return sorted(promising, key=lambda pair: (pair.left > (1.0 + TIE) * least, pair.size, pair.left))[:MOST]


def _beside(
    coarse: ChannelData, good: BoolArray, effects: tuple[Effect, ...], memory: Memory, first: Trial
) -> list[Candidate]:
    """The candidates that do best beside the base model with a first effect."""
    beside = fit(coarse, first.model, first.parameters, good, memory)
    return _screened(beside, coarse, effects)[:BESIDE]


def _screened(standing: Fit, coarse: ChannelData, effects: tuple[Effect, ...]) -> list[Candidate]:
    """Candidates beside a model, without their blocks: of long data, those of all pairs fill the memory."""
    found = screen(standing, candidates(coarse, standing.trial.model, effects))
    return [replace(candidate, search=candidate.search.without_blocks()) for candidate in found]


def coarse_copy(frame: Frame) -> ChannelData:
    """The channel averaged over blocks, one sample for each."""
    data, mean = frame.data, frame.reduce
    return ChannelData(
        data.name,
        data.kind,
        mean(data.time_s),
        mean(data.position),
        mean(data.velocity),
        mean(data.acceleration),
        mean(data.effort),
        frame.run,
        data.phase[frame.rows[:, 0]],
        {name: mean(signal) for name, signal in data.context.items()},
        data.surface,
        data.tare,
        data.recorded,
    )
