"""Resistance that grows with the square of speed."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class QuadraticDamping(AdditiveEffect):
    """F = c2 v |v| while pressed."""

    name = "quadratic_damping"
    kind = Kind.RATE_DEPENDENCE
    physics = "Fluid pushed out of the way resists with the square of speed."
    equation = "F = c2 v |v|"
    source = "L. Prandtl, O. Tietjens, Applied Hydro- and Aeromechanics (1934): drag at high Reynolds number"
    signature = "the gap between in and out grows faster than in proportion to speed"
    signals = ("velocity",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("c2", "{effort} s^2/{position}^2", 0.0, 1e12, (1.0, 10000.0)),)
    confused_with = {
        "damping": "probe at three speeds: twice the speed gives four times the force",
        "dry_friction": "probe at three speeds: friction does not depend on speed",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.where(data.engaged, data.velocity * np.abs(data.velocity), 0.0)[:, None]
