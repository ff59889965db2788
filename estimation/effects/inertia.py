"""A mass, or a moment of inertia."""

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class Inertia(AdditiveEffect):
    """effort = m a."""

    name = "inertia"
    kind = Kind.INERTIA
    physics = "Mass resists acceleration."
    equation = "effort = m a"
    source = "I. Newton, Principia (1687)"
    signature = "effort follows acceleration at any position and speed"
    signals = ("acceleration",)
    channels = frozenset(ChannelKind)
    one_sided = False
    gains = (Parameter("m", "{inertia}", 0.0, 1e12, (0.0001, 200.0)),)
    confused_with = {
        "armature": "none in one channel: a rotor adds to the inertia of its joint",
        "lag": "move at two frequencies: a lag turns stiffness into apparent damping first",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.acceleration[:, None]
