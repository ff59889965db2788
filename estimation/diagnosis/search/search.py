"""What a search for missing effects works on, and what it remembers of what it has tried."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.fit.inner_search import look, refine
from estimation.fit.memory import Memory
from estimation.fit.standing import Fit, Standing, fit, stand
from estimation.fit.unexplained import is_explained
from estimation.diagnosis.each import Each, one_by_one
from estimation.fit.acceleration_doubt import doubted
from estimation.diagnosis.search.candidate import Candidate
from estimation.diagnosis.search.credible import is_credible
from estimation.diagnosis.search.library import candidates
from estimation.diagnosis.search.screening import try_all
from estimation.effect import Effect, SensorEffect
from estimation.model import Model
from robot_io.types import BoolArray

BETTER = 0.98  # of the energy left before, that another place to start from must promise
REACHES_S = (0.01, 0.03)  # over which positions are asked for an acceleration: where they are exact, or not
Progress = Callable[[str, float], None]
_Key = tuple[frozenset[str], tuple[str, ...]]


@dataclass(frozen=True)
class Search:
    """The channel, the base model and the library; models that were fitted or extended are remembered.

    Attributes:
        data: the channel.
        model: the base model.
        good: samples that are fit for use, shape (n,).
        effects: the library.
        rng: for surrogates.
        progress: told what is being done, and the share of it that is done.
        each: does the same work on several things, perhaps in several processes.
    """

    data: ChannelData
    model: Model
    good: BoolArray
    effects: tuple[Effect, ...]
    rng: np.random.Generator
    progress: Progress
    each: Each = one_by_one
    _memory: Memory = field(default_factory=Memory)
    _standings: dict[_Key, Standing] = field(default_factory=dict)
    _screened: dict[_Key, list[Candidate]] = field(default_factory=dict)

    @property
    def start(self) -> Standing:
        """The base model alone."""
        return self.stand(self.model, {})

    @property
    def floor(self) -> float:
        """Energy on blocks of held-out runs that no smooth law explains beside any model fitted so far."""
        return min(float(standing.flexible.held_out.sum()) for standing in self._standings.values())

    def is_explained(self, standing: Standing) -> bool:
        """Whether a model leaves no more than noise, as far as is known by now, and is what its names say."""
        return self.leaves_noise(standing) and is_credible(self.start, standing)

    def leaves_noise(self, standing: Standing) -> bool:
        """Whether a model leaves no more than noise, as far as is known by now."""
        return is_explained(standing, self.floor)

    def screen(self, standing: Standing) -> list[Candidate]:
        """All candidates beside the model of `standing` that are possible."""
        return [candidate for candidate in self.tried(standing) if candidate.possible]

    def tried(self, standing: Standing) -> list[Candidate]:
        """All candidates beside the model of `standing`, also those whose parameters made no sense."""
        model = standing.trial.model
        if _key(model) not in self._screened:
            tried = candidates(standing.data, model, self.effects)
            what = f"{self.data.name}: beside {', '.join(e.name for e in model.effects)}"
            self._screened[_key(model)] = try_all(
                standing, tried, lambda share, name: self.progress(f"{what}: {name}", share)
            )
        return self._screened[_key(model)]

    def stand(self, model: Model, parameters: Mapping[str, float]) -> Standing:
        """A model, fitted from these parameters on."""
        if _key(model) not in self._standings:
            self._standings[_key(model)] = self._fresh(model, parameters)
        return self._standings[_key(model)]

    def _fresh(self, model: Model, parameters: Mapping[str, float]) -> Standing:
        return stand(self.data, model, parameters, self.good, self._memory)

    def with_candidate(self, candidate: Candidate) -> Standing:
        """The model that the candidate was tried in; fitted anew if that is a better place to start."""
        best = candidate.search.best
        known = self._standings.get(_key(best.model))
        if known is not None and best.sse < BETTER * known.trial.sse:
            return self.stand_anew(best.model, best.parameters)
        return self.stand(best.model, best.parameters)

    def together(self, candidate: Candidate) -> Fit:
        """The model that the candidate was tried in, with all parameters fitted together."""
        best = candidate.search.best
        known = self._standings.get(_key(best.model))
        if known is not None and best.sse >= BETTER * known.trial.sse:
            return known
        return fit(self.data, best.model, best.parameters, self.good, self._memory)

    def by_positions(self, candidate: Candidate) -> list[Fit]:
        """See `together`, with the accelerations that a joint's positions speak for; none for a contact."""
        if self.data.kind is ChannelKind.CONTACT:
            return []
        known = self.together(candidate).trial
        told = [doubted(self.data, reach_s) for reach_s in REACHES_S]
        return [fit(data, known.model, known.parameters, self.good) for data in told]

    def stand_anew(self, model: Model, parameters: Mapping[str, float]) -> Standing:
        """A model, fitted from these parameters on whatever is known, and remembered if that is better."""
        anew, known = self._fresh(model, parameters), self._standings.get(_key(model))
        if known is None or anew.trial.sse < BETTER * known.trial.sse:
            self._screened.pop(_key(model), None)
            self._standings[_key(model)] = anew
        return self._standings[_key(model)]

    def elsewhere(self, standing: Standing, name: str) -> Standing:
        """The same model, with one effect looked for afresh beside the others as they are."""
        model, known = standing.trial.model, standing.trial.parameters
        effect = next(effect for effect in model.effects if effect.name == name)
        looked = look(standing.plain, model, effect, known, effect.starts(standing.data))
        best = refine(standing.plain, model, effect, looked).best
        if best.sse >= BETTER * standing.trial.sse:
            return standing
        return self.stand_anew(model, best.parameters)

    def without(self, standing: Standing, name: str) -> Standing:
        """The model of `standing` less one effect."""
        return self.stand(standing.trial.model.without(name), standing.trial.parameters)


def _key(model: Model) -> _Key:
    """Effects add up in any order; what sensors do does not."""
    sensors = tuple(effect.name for effect in model.effects if isinstance(effect, SensorEffect))
    return frozenset(effect.name for effect in model.effects), sensors
