"""Which effects are tried on a channel."""

from collections.abc import Iterable

from estimation.channel import ChannelData, ChannelKind
from estimation.fit.load import HEAVY
from estimation.effect import Effect
from estimation.effects import EFFECTS
from estimation.model import Model

# Parts of base models, or other names of a term that the channel's own vocabulary has.
_NOT_TRIED = {
    ChannelKind.CONTACT: frozenset({"inertia", "pendulum"}),
    ChannelKind.REVOLUTE: frozenset({"inertia", "pendulum", "stiffness", "damping"}),
    ChannelKind.PRISMATIC: frozenset({"inertia", "stiffness", "damping"}),
}
_BASES = frozenset({"rigid_body", "rigid_body_fitted"})


def library() -> tuple[Effect, ...]:
    """One of every effect that palpate knows."""
    return tuple(effect() for effect in EFFECTS.values())


def candidates(data: ChannelData, model: Model, effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """The effects that can be tried on this channel beside what the model has."""
    present = {effect.name for effect in model.effects}
    # a tilt turns a weight that is there; beside one, what else goes round with the angle is a tilt
    skipped = _NOT_TRIED[data.kind] | _BASES | present | {"weight" if present & HEAVY else "gravity_tilt"}
    return tuple(e.suited_to(data) for e in effects if e.name not in skipped and e.applies_to(data))
