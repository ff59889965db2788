"""The base does not stand level."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from robot_io.types import FloatArray


class GravityTilt(AdditiveEffect):
    """effort = tilt * (effort per radian of tilt); for a pendulum this is cos(q)."""

    name = "gravity_tilt"
    physics = "Gravity pulls from another direction than the model assumes."
    equation = "effort = t dg(q)/dtilt; for a pendulum t cos(q)"
    source = "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots (2002), ch. 9"
    signature = "an error that depends on posture alone, a quarter turn out of step with gravity"
    channels = frozenset({ChannelKind.REVOLUTE})
    gains = (Parameter("tilt", "{effort} per unit", -10000.0, 10000.0, (0.001, 5.0)),)
    confused_with: ClassVar[dict[str, str]] = {
        "bias": "move over a wide range: a bias is the same in every posture",
        "joint_spring": "move over a wide range",
        "payload": "change the posture: weight and tilt are a quarter turn apart",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 1)."""
        per_radian = data.context.get("tilt_effort_per_rad")
        return (np.cos(data.position) if per_radian is None else per_radian)[:, None]
