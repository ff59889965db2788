"""The effort that a joint carries apart from friction, which some frictions grow with."""

from collections.abc import Mapping
from dataclasses import replace

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.model import Model

LOAD = "load"
LUMPED = "lumped_inertia_effort"  # part of the load, of which the drive's rotor may take some before the gear
# Effects in which weight acts, and all whose effort is a load;
# not the armature: what accelerates a rotor does not pass through the gear
HEAVY = frozenset({"pendulum", "rigid_body", "rigid_body_fitted", "payload", "gravity_tilt", "weight"})
CARRYING = HEAVY | {"inertia"}
_LUMPED = {"inertia": "m", "pendulum": "inertia"}  # the gain in which link and rotor are one


def with_load(data: ChannelData, model: Model, parameters: Mapping[str, float]) -> ChannelData:
    """The channel with the signal `load`: what the model's masses and weights take.

    What an inertia takes that may be the rotor's as well as the link's is a signal of its own, beside
    weights: by itself it only scales the load.

    A contact, a channel that brings its own, and a model without masses are returned as they are.
    """
    carrying = Model(model.name, tuple(e for e in model.effects if e.name in CARRYING))
    if data.kind is ChannelKind.CONTACT or LOAD in data.context or not carrying.effects:
        return data
    signals = {LOAD: carrying.predict(data, parameters)}
    names = {effect.name for effect in carrying.effects}
    if names & _LUMPED.keys() and names - {"inertia"}:
        inertia = sum(parameters[f"{name}.{_LUMPED[name]}"] for name in names & _LUMPED.keys())
        signals[LUMPED] = inertia * data.acceleration
    return replace(data, context={**data.context, **signals})
