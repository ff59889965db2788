"""The base does not stand level."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray

_STARTS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # rad, to either side
_OF_TILT = ("tilt_effort_per_rad", "weight_effort")
_OF_ARM = "payload_effort_per_kg"  # which every joint of an arm has whose kinematics are known


class GravityTilt(AdditiveEffect):
    """effort = tilt * cos(q) beside a pendulum, whose own sin(q) takes up what the tilt takes off its weight.

    An arm of known weight g has nothing to take that up: with the base turned by t about the axis of the
    first joint, effort = sin(t) dg/dt + (cos(t) - 1) g.
    """

    name = "gravity_tilt"
    kind = Kind.GRAVITY_LOAD
    physics = "Gravity pulls from another direction than the model assumes."
    equation = "effort = sin(t) dg(q)/dtilt + (cos(t) - 1) g(q); for a pendulum t cos(q)"
    source = "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots (2002), ch. 9"
    signature = "an error that depends on posture alone, a quarter turn out of step with gravity"
    signals = ("position", "other joints")
    channels = frozenset({ChannelKind.REVOLUTE})
    gains: ClassVar[tuple[Parameter, ...]] = (
        Parameter("tilt", "{effort} per unit", -1e12, 1e12, (0.001, 5.0)),
    )
    confused_with = {
        "bias": "move over a wide range: a bias is the same in every posture",
        "joint_spring": "judge all joints together: a tilt is in all of them; or move over a wide range",
        "payload": "change the posture: weight and tilt are a quarter turn apart",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.cos(data.position)[:, None]

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`; an arm of several joints is no pendulum: its own form, or none."""
        return super().applies_to(data) and (_OF_ARM not in data.context or _is_known(data))

    def suited_to(self, data: ChannelData) -> "GravityTilt":
        return _TiltOfKnownArm() if _is_known(data) else self


class _TiltOfKnownArm(GravityTilt):
    needs = _OF_TILT
    gains = ()
    inner = (Parameter("tilt", "rad", -np.pi, np.pi, (-0.3, 0.3)),)

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.zeros((len(data), 0))

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        across, along = (data.context[name] for name in _OF_TILT)
        turned: FloatArray = np.sin(inner["tilt"]) * across + (np.cos(inner["tilt"]) - 1.0) * along
        return turned

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return tuple({"tilt": side * start} for side in (-1.0, 1.0) for start in _STARTS)


def _is_known(data: ChannelData) -> bool:
    """Whether it was computed what the tilt takes; that is not done where the first axis is not level."""
    return set(_OF_TILT) <= set(data.context)
