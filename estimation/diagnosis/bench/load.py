"""The effort that a joint carries apart from friction, which some frictions grow with."""

from collections.abc import Mapping
from dataclasses import replace

from estimation.channel import ChannelData, ChannelKind
from estimation.model import Model

LOAD = "load"
CARRYING = frozenset(
    {"inertia", "armature", "pendulum", "rigid_body", "rigid_body_fitted", "payload", "gravity_tilt"}
)


def with_load(data: ChannelData, model: Model, parameters: Mapping[str, float]) -> ChannelData:
    """The channel with the signal `load`: what the model's masses and weights take.

    A contact, a channel that brings its own, and a model without masses are returned as they are.
    """
    carrying = Model(model.name, tuple(e for e in model.effects if e.name in CARRYING))
    if data.kind is ChannelKind.CONTACT or LOAD in data.context or not carrying.effects:
        return data
    load = carrying.predict(data, parameters)
    return replace(data, context={**data.context, LOAD: load})
