"""The arm's own masses, found from the data."""

import numpy as np

from estimation.arm.base_parameters import BaseParameters, inertial_name, inertial_unit
from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class RigidBodyFitted(AdditiveEffect):
    """torque = Y(q, v, a) pi; the signal `rigid_body_regressor`; and J^T F where the tip presses.

    The gains are base parameters of the whole arm: of one name in all its joints, they are one parameter.

    Args:
        chosen: columns of the regressor, ten a link (`control.arm.rigid_body.RigidBody.regressor`), of the
            arm's base parameters that the joint feels (`estimation.arm.base_parameters`).
        arm: all base parameters of the arm; None where joints are fitted each by itself.
        urdf: inertial parameters of its URDF, shape (10 links,).
    """

    name = "rigid_body_fitted"
    kind = Kind.GRAVITY_LOAD
    physics = "Inertia, Coriolis forces and weight of the links load the joint, by as much as the data say."
    equation = "tau = Y(q, v, a) pi, row of the joint, pi the base parameters of the arm"
    source = (
        "C. G. Atkeson, C. H. An, J. M. Hollerbach, IJRR 5(3) (1986); M. Gautier, J. Robotic "
        "Systems 8 (1991): numerical calculation of the base inertial parameters"
    )
    signature = "torque follows posture and acceleration of all joints"
    signals = ("position", "velocity", "acceleration", "other joints")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    needs = ("rigid_body_regressor",)
    confused_with = {"payload": "none in one recording: a payload belongs to the last link's parameters"}

    def __init__(
        self,
        chosen: tuple[int, ...] = (),
        arm: BaseParameters | None = None,
        urdf: FloatArray | None = None,
    ) -> None:
        self.arm, self.urdf = arm, urdf
        self._chosen = list(chosen)
        self.gains = tuple(  # type: ignore[misc]  # how many there are depends on the arm
            Parameter(inertial_name(i), inertial_unit(i), -1e3, 1e3, (-5.0, 5.0)) for i in chosen
        )

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, len(chosen))."""
        return data.context["rigid_body_regressor"][:, self._chosen]

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.context.get("contact_torque", np.zeros(len(data)))
