"""The arm's own masses, as its URDF says."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner
from estimation.kinds import Kind
from robot_io.types import FloatArray


class RigidBody(AdditiveEffect):
    """torque = ID(q, v, a) of the URDF as it is, the signal `rigid_body_torque`; and J^T F of the tip."""

    name = "rigid_body"
    kind = Kind.GRAVITY_LOAD
    physics = "Inertia, Coriolis forces and weight of the links load the joint."
    equation = "tau = M(q) a + C(q, v) v + g(q), row of the joint"
    source = "R. Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 5: RNEA"
    signature = "torque follows posture and acceleration of all joints"
    signals = ("position", "velocity", "acceleration", "other joints")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    needs = ("rigid_body_torque",)
    confused_with = {
        "payload": "weigh the tool: a payload acts on all joints in proportion",
        "torque_gain": "hold a known weight: a wrong gain changes its torque too",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 0): nothing is free."""
        return np.zeros((len(data), 0))

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.context["rigid_body_torque"] + data.context.get("contact_torque", 0.0)
