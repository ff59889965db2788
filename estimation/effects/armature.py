"""The rotor's inertia, seen through the gear."""

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class Armature(AdditiveEffect):
    """effort = Ja a of the joint itself."""

    name = "armature"
    kind = Kind.INERTIA
    physics = "The motor's rotor must be accelerated too, by the square of the gear ratio."
    equation = "effort = Ja a"
    source = "R. Featherstone, Rigid Body Dynamics Algorithms (2008), sec. 9.6"
    signature = "effort follows the joint's own acceleration, in any posture"
    signals = ("acceleration",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (Parameter("inertia", "{inertia}", 0.0, 1e12, (0.001, 5.0)),)
    confused_with = {
        "lag": "move at two frequencies",
        "payload": "hold still in several postures: a rotor has no weight",
        "inertia": "none in one channel: a rotor adds to the inertia of its joint",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.acceleration[:, None]
