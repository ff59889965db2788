"""Tries every effect beside a model."""

from collections.abc import Callable, Sequence

import numpy as np

from estimation.fit.inner_search import Attempts, look, refine
from estimation.fit.polish import polish
from estimation.fit.standing import Fit
from estimation.fit.trial import Trial
from estimation.diagnosis.search.candidate import Candidate
from estimation.diagnosis.search.possible import LOOSE, is_possible
from estimation.effect import Effect, SensorEffect
from estimation.model import Model

PROMISING = 0.3  # of what the best candidate takes away at its starts; those below are not tried in between
REFINED = 5  # candidates that are tried in between in any case


def screen(
    standing: Fit,
    effects: Sequence[Effect],
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> list[Candidate]:
    """The effects that are possible beside the model, of all that were tried; see `try_all`."""
    return [candidate for candidate in try_all(standing, effects, progress) if candidate.possible]


def try_all(
    standing: Fit,
    effects: Sequence[Effect],
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> list[Candidate]:
    """Try each effect beside the model from where things stand; best in held-out runs first.

    All are tried at their starts, those that do well there also in between. What would be impossible beside
    the other parameters as they were may be possible once all are fitted together.
    """
    looked, places = [], _places(standing.trial)
    for number, effect in enumerate(effects):
        progress(number / len(effects), effect.name)
        starts = effect.starts(standing.data)
        tried = [
            look(standing.plain, model, effect, parameters, starts)
            for model in extended(standing.trial.model, effect)
            for parameters in places
        ]
        looked.append(min(tried, key=lambda one: one.best.sse))
    gains = np.array([standing.trial.sse - tried.best.sse for tried in looked])
    least = min(PROMISING * gains.max(initial=0.0), np.sort(gains)[-REFINED:].min(initial=np.inf))
    found = []
    for effect, first, gain in zip(effects, looked, gains, strict=True):
        best = refine(standing.plain, first.best.model, effect, first) if gain >= least else first
        possible = is_possible(effect, best.best, standing.plain, LOOSE)
        if not possible and gain >= PROMISING * gains.max():
            best = Attempts((*best.trials, polish(standing.plain, best.best)), best.start_count)
            possible = is_possible(effect, best.best, standing.plain, LOOSE)
        found.append(Candidate(effect, best, possible))
    return sorted(found, key=lambda candidate: candidate.held_out)


def _places(trial: Trial) -> list[dict[str, float]]:
    """Where effects are tried: as things stand, and as if an offset (what may be nothing) were none."""
    nothing = {name: 0.0 for name, inner in trial.model.inner.items() if inner.lower < 0.0 < inner.upper}
    return [trial.parameters, *([{**trial.parameters, **nothing}] if nothing else [])]


def extended(model: Model, effect: Effect) -> list[Model]:
    """The model with one more effect; what a sensor does may come before or after what it already does."""
    if isinstance(effect, SensorEffect) and any(isinstance(e, SensorEffect) for e in model.effects):
        return [model.with_effect(effect), model.with_effect_first(effect)]
    return [model.with_effect(effect)]
