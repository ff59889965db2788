"""A linear damper."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class Damping(AdditiveEffect):
    """F = c v; in a contact the damper acts only while the object is pressed (x > 0)."""

    name = "damping"
    kind = Kind.RATE_DEPENDENCE
    physics = "A dashpot resists in proportion to speed."
    equation = "F = c v"
    source = "the viscous half of the Kelvin-Voigt body; W. Flügge, Viscoelasticity (1975), ch. 1"
    signature = "effort is higher while moving in than while moving out at the same depth, more so with speed"
    signals = ("velocity",)
    channels = frozenset(ChannelKind)
    gains = (Parameter("c", "{effort} s/{position}", 0.0, 1e12, (0.1, 500.0)),)
    confused_with = {
        "delay": "probe at two speeds and hold: a delay shifts force in time, a damper vanishes at rest",
        "viscous_friction": "none in one channel: it is the same term, named for a joint",
        "stress_relaxation": "hold: relaxation goes on at rest, damping does not",
        "hysteresis": "probe at two speeds: hysteresis does not depend on speed",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.where(data.engaged, data.velocity, 0.0)[:, None]
