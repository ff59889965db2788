"""Friction that grows with the load and builds up over a short path after each reversal."""

import numpy as np

from estimation.channel import ChannelData
from estimation.effect import Inner, Parameter
from estimation.effects.presliding_friction import PreslidingFriction
from estimation.kinds import Kind
from robot_io.types import FloatArray


class LoadDependentPresliding(PreslidingFriction):
    """effort = mu |load| s; s as in `presliding_friction`."""

    name = "load_dependent_presliding"
    kind = Kind.FRICTION
    physics = "Cables over pulleys and loaded teeth rub as much as they carry, and stay stretched at rest."
    equation = "effort = mu |load| s, ds/dq = (1 - s sign(v))/presliding"
    source = (
        "P. R. Dahl, Aerospace Corp. TOR-158 (1968); L. Euler, Mém. Acad. Berlin 18 (1762): capstan; "
        "M. Kaneko et al., IEEE ICRA (1991): tendon drives"
    )
    signature = "the jump at reversal grows with the load, is spread over a path, and stays at rest"
    signals = ("direction", "past motion", "load")
    gains = (Parameter("mu", "1", 0.0, 2.0, (0.01, 0.5)),)
    needs = ("load",)
    confused_with = {
        "load_dependent_friction": "stop under load: presliding friction keeps its last value at rest",
        "presliding_friction": "repeat with another load",
        "torque_gain": "lift and lower the same load: friction changes sign with the motion, a gain does not",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return super().columns(data, inner) * np.abs(data.context["load"])[:, None]
