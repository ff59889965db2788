"""Whether a model that explains all can be believed: is each of its effects what its name says?

An effect that is not in the library can be drawn by others in a way that nobody would call by their names:
a second layer below a first one that pulls, a Stribeck law whose rise is nowhere seen, three effects that add
up to a constant. What fits is then no evidence for the names.
"""

import numpy as np

from estimation.fit.plain_laws import left_by_plain_signals
from estimation.fit.standing import Standing
from estimation.fit.trial import Bench, Trial
from estimation.fit.intervals import final, values
from estimation.diagnosis.search.candidate import TIE, size
from estimation.diagnosis.search.possible import is_beyond_bounds
from estimation.effect import Effect

_NORMAL_95 = 1.96  # standard errors to either side, that an interval is stated with


def is_credible(start: Standing, standing: Standing) -> bool:
    """Whether a model is what its names say, and no roundabout way to draw something simpler.

    Args:
        start: the base model alone.
        standing: that with effects added.
    """
    return _is_sensible(standing.trial, standing.plain) and not _is_roundabout(start, standing)


def is_misnamed(effect: Effect, trial: Trial, bench: Bench) -> bool:
    """Whether the effect has become another thing than its name says, see `Effect.is_misnamed`.

    Args:
        effect: part of the model.
        trial: of the model.
        bench: where.
    """
    data = trial.model.moved(bench.frame.data, trial.parameters)
    return effect.is_misnamed(data, trial.parameters, lambda: _errors(trial, bench), _noise(trial, bench))


def may_be_nothing(effect: Effect, standing: Standing) -> bool:
    """Whether zero lies within the intervals that would be stated, of all that makes an effect what it is.

    Held-out runs and surrogates do not know of what the error of a derived acceleration turns gains by; the
    intervals do.

    Args:
        effect: part of the model, which is complete.
        standing: of the model.
    """
    found = values(*final(standing, complete=True))
    gains = [f"{effect.name}.{name}" for name in effect.essential or [gain.name for gain in effect.gains]]
    return bool(gains) and all(abs(found[name].value) < _NORMAL_95 * found[name].std_err for name in gains)


def _is_sensible(trial: Trial, bench: Bench) -> bool:
    """Whether no effect is misnamed, and no gain clearly beyond its bounds, the base model's included.

    A wrong effect may explain all if only the spring is allowed to pull.
    """
    misnamed = any(is_misnamed(effect, trial, bench) for effect in trial.model.effects)
    return not misnamed and not is_beyond_bounds(trial, _noise(trial, bench))


def _is_roundabout(start: Standing, standing: Standing) -> bool:
    """Whether a constant, or a trend in time, explains as much as effects with more parameters."""
    base = {effect.name for effect in start.trial.model.effects}
    added = sum(size(effect) for effect in standing.trial.model.effects if effect.name not in base)
    limit = (1.0 + TIE) * standing.trial.held_out
    return any(added > count and left <= limit for count, left in left_by_plain_signals(start))


def _errors(trial: Trial, bench: Bench) -> dict[str, float]:
    return {name: value.std_err for name, value in values(bench, trial).items()}


def _noise(trial: Trial, bench: Bench) -> float:
    return float(np.sqrt(np.mean(bench.whiten(trial.residual) ** 2)))
