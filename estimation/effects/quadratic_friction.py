"""Friction that grows with the square of speed."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class QuadraticFriction(AdditiveEffect):
    """effort = d2 v |v|."""

    name = "quadratic_friction"
    kind = Kind.RATE_DEPENDENCE
    physics = "Air, oil churning and motor fans resist with the square of speed."
    equation = "effort = d2 v |v|"
    source = "L. Prandtl, O. Tietjens, Applied Hydro- and Aeromechanics (1934): drag at high Reynolds number"
    signature = "effort rises faster than in proportion to speed"
    signals = ("velocity",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (Parameter("d2", "{effort} s^2/{position}^2", 0.0, 1e12, (0.0001, 50.0)),)
    confused_with = {
        "viscous_friction": "move at three speeds",
        "stribeck_friction": "move very slowly and very fast",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return (data.velocity * np.abs(data.velocity))[:, None]
