"""Effects in the forms that suit a channel, created once so that caches recognize them.

Caches of columns compare effects by identity. An effect that was created again would be computed again.
"""

from dataclasses import dataclass, field
from functools import lru_cache

from palpate.estimation.channel import ChannelData
from palpate.estimation.effect import Effect
from palpate.estimation.fit.blocks import LOAD, LUMPED
from palpate.estimation.signals.cache_by_array import IdentityKey

_MOST_EFFECTS = 512  # effects that are kept
_MAX_SAMPLES = 100_000  # samples; longer channels are not kept alive by a cache
_SIGNALS = ("time_s", "run", "position", "velocity", "acceleration", "effort", "phase", "touching")


@dataclass(frozen=True)
class _Suiting:
    """An effect with the arrays of the channel to which it is suited."""

    effect: IdentityKey
    arrays: tuple[IdentityKey, ...]
    context: tuple[str, ...]  # names of the signals of the context
    data: ChannelData = field(compare=False)


def suited_effect(effect: Effect, data: ChannelData) -> Effect:
    """Return the form of an effect that suits a channel; see `Effect.suited_to`.

    The load differs between models of a channel, so that only its presence counts for an effect that does not
    need it, and nothing is kept for one that does.

    Args:
        effect: the effect.
        data: the channel.
    """
    if LOAD in effect.needs or len(data) > _MAX_SAMPLES:
        return effect.suited_to(data)
    names = tuple(sorted(data.context))
    signals = [data.context[name] for name in names if name not in {LOAD, LUMPED}]
    arrays = tuple(map(IdentityKey, [*(getattr(data, name) for name in _SIGNALS), *signals]))
    return _suited(_Suiting(IdentityKey(effect), arrays, names, data))


@lru_cache(maxsize=_MOST_EFFECTS)
def _suited(suiting: _Suiting) -> Effect:
    suited: Effect = suiting.effect.wrapped.suited_to(suiting.data)
    return suited


def forms_of(effect: Effect) -> tuple[Effect, ...]:
    """Return the forms of an effect; see `Effect.forms`.

    Args:
        effect: the effect.
    """
    return _forms(IdentityKey(effect))


@lru_cache(maxsize=_MOST_EFFECTS)
def _forms(effect: IdentityKey) -> tuple[Effect, ...]:
    return tuple(effect.wrapped.forms())
