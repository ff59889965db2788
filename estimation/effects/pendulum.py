"""A body that swings under gravity."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class Pendulum(AdditiveEffect):
    """torque = J a + g1 sin(q), q = 0 hanging straight down."""

    name = "pendulum"
    kind = Kind.GRAVITY_LOAD
    physics = "A body turns about a horizontal axis."
    equation = "torque = J a + g1 sin(q)"
    source = "C. Huygens, Horologium Oscillatorium (1673)"
    signature = "torque follows the sine of the angle, whatever the speed"
    signals = ("position", "acceleration")
    channels = frozenset({ChannelKind.REVOLUTE})
    gains = (
        Parameter("inertia", "kg m^2", 0.0, 10000.0, (0.0001, 5.0)),
        Parameter("gravity", "N m", -1e12, 1e12, (0.05, 50.0)),
    )
    confused_with = {
        "gravity_tilt": "turn the base by a known angle",
        "joint_spring": "swing by more than 60 degrees: a sine bends, a spring does not",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.column_stack([data.acceleration, np.sin(data.position)])
