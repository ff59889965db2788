"""A spring, cable or hose that pulls the joint."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class JointSpring(AdditiveEffect):
    """effort = k q + p: a spring at rest where q = -p / k."""

    name = "joint_spring"
    kind = Kind.ELASTIC_SHAPE
    physics = "A balancing spring, or a cable that is bent with the joint, pulls it towards one place."
    equation = "effort = k q + p, at rest where q = -p/k"
    source = "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots (2002), ch. 9"
    signature = "effort grows in proportion to position, whatever the speed"
    signals = ("position",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (
        Parameter("k", "{effort}/{position}", -1e12, 1e12, (0.01, 1000.0)),
        Parameter("preload", "{effort}", -1e12, 1e12, (-10.0, 10.0)),
    )
    essential = ("k",)
    confused_with = {
        "bias": "move over a wide range: a bias is the same everywhere",
        "gravity_tilt": "judge all joints together: a tilt is in all of them; or move over a wide range",
        "cubic_stiffness": "move over a wide range",
        "stiffness": "none in one channel: it is the same term, named for a contact",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.column_stack([data.position, np.ones(len(data))])
