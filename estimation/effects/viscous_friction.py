"""Friction in proportion to speed."""

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class ViscousFriction(AdditiveEffect):
    """effort = d v."""

    name = "viscous_friction"
    kind = Kind.RATE_DEPENDENCE
    physics = "Oil and bearings resist in proportion to speed."
    equation = "effort = d v"
    source = "B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994)"
    signature = "effort is higher by an amount in proportion to speed, in either direction"
    signals = ("velocity",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (Parameter("d", "{effort} s/{position}", 0.0, 1e12, (0.001, 500.0)),)
    confused_with = {
        "joint_coupling": "hold this joint still and move its neighbour",
        "delay": "move at two speeds with the same acceleration",
        "lag": "move at two speeds with the same acceleration",
        "damping": "none in one channel: it is the same term, named for a contact",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.velocity[:, None]
