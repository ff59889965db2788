"""A body whose weight the model does not know."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class Weight(AdditiveEffect):
    """torque = g1 sin(q) + g2 cos(q), whatever angle is called zero.

    For a joint whose model has no weight; that of an arm is in its kinematics.
    """

    name = "weight"
    kind = Kind.GRAVITY_LOAD
    physics = "The joint's axis is not upright, and what it carries has its centre off the axis."
    equation = "torque = g1 sin(q) + g2 cos(q)"
    source = "C. Huygens, Horologium Oscillatorium (1673)"
    signature = "effort follows the sine of the angle, whatever the speed, and comes back with each turn"
    signals = ("position",)
    channels = frozenset({ChannelKind.REVOLUTE})
    gains = (
        Parameter("g1", "N m", -1e12, 1e12, (-50.0, 50.0)),
        Parameter("g2", "N m", -1e12, 1e12, (-50.0, 50.0)),
    )
    confused_with = {
        "joint_spring": "swing by more than 60 degrees: a sine bends, a spring does not",
        "cubic_stiffness": "swing by more than 90 degrees: a sine turns back, a cubic does not",
        "bias": "move over a wide range: a bias is the same everywhere",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.column_stack([np.sin(data.position), np.cos(data.position)])

    def applies_to(self, data: ChannelData) -> bool:
        return super().applies_to(data) and "payload_effort_per_kg" not in data.context
