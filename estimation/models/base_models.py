"""Base models of contacts, spring-mass-damper systems and joints, also in an arm whose URDF is known."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from palpate.estimation.arm.inertial_parameters import base_parameters
from palpate.estimation.base_model import BaseModel, ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effects.elastic_shape import Stiffness
from palpate.estimation.effects.gravity_load import KnownRigidBody, Pendulum, RigidBodyFitted
from palpate.estimation.effects.inertia import Inertia
from palpate.estimation.effects.rate_dependence import Damping, HuntCrossley, ViscousFriction
from palpate.estimation.model import Model
from palpate.estimation.signals.arm_signals import with_rigid_body
from palpate.estimation.statistics.correlation import correlation_coefficient
from palpate.robot_io.errors import InputError

if TYPE_CHECKING:
    from palpate.control.arm.rigid_body import RigidBody


class KelvinVoigt(BaseModel):
    """F = k x + c v while x > 0."""

    name = "kelvin_voigt"
    channels = frozenset({ChannelKind.CONTACT})
    effects = (Stiffness, Damping)


class HuntCrossleyModel(BaseModel):
    """F = k x^n + b x^n v while x > 0."""

    name = "hunt_crossley"
    channels = frozenset({ChannelKind.CONTACT})
    effects = (HuntCrossley,)


_MIN_CORRELATION = 0.5  # least correlation of force and displacement outside the object of an attached spring


class SpringMassDamper(BaseModel):
    """F = m a + c v + k x; the force can also pull, as with a spring that is attached at both ends."""

    name = "spring_mass_damper"
    channels = frozenset(ChannelKind)
    effects = (Inertia, Damping, Stiffness)

    def prepare(self, data: ChannelData, context: ModelContext) -> ChannelData:
        """Mark all samples as in contact if the force outside the object follows the position."""
        is_outside = data.position < 0.0
        x, force = data.position[is_outside], data.effort[is_outside]
        is_contact = data.kind is ChannelKind.CONTACT
        if is_contact and len(x) >= 3 and correlation_coefficient(x, force) > _MIN_CORRELATION:
            return replace(data, touching=np.ones(len(data), dtype=np.bool_))
        return data


class InertiaModel(BaseModel):
    """effort = m a + d v."""

    name = "inertia"
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    effects = (Inertia, ViscousFriction)


class PositionServoModel(BaseModel):
    """goal - position = (J a + (d + kt^2/R) v) / K, K = kp V kt/R: a servo without measured effort.

    The firmware applies the voltage kp V (goal - position) to the motor. The torque is kt/R times this
    voltage minus the back-EMF term kt^2/R v (M. Duclusaud, G. Passault, V. Padois, O. Ly, arXiv:2410.08650).
    Without a measured effort, K and the parts of the damping cannot be separated, so all parameters refer to
    rad of goal error.
    """

    name = "position_servo"
    channels = frozenset({ChannelKind.SERVO})
    effects = (Inertia, ViscousFriction)


class PendulumModel(BaseModel):
    """torque = J a + g1 sin(q) + d v, q = 0 hanging straight down."""

    name = "pendulum"
    channels = frozenset({ChannelKind.REVOLUTE})
    effects = (Pendulum, ViscousFriction)


def arm_of(context: ModelContext, model: str) -> tuple["RigidBody", int]:
    """Return the arm of a context, and the index of the joint from 0.

    Args:
        context: context with the URDF and the index of the joint.
        model: name of the model for error messages.

    Raises:
        InputError: the context has no URDF or no joint, or the arm does not have this joint.
    """
    arm = context.arm
    if not arm.urdf or context.joint is None:
        raise InputError(f"model '{model}' needs a joint channel and the arm's URDF (--urdf FILE)")
    from palpate.control.arm.rigid_body import RigidBody  # noqa: PLC0415, needs Pinocchio

    body = RigidBody.from_urdf(
        arm.urdf, arm.tip_frame, arm.gravity_m_s2, arm.rotor_inertia_kg_m2, origin=arm.origin
    )
    if not 0 <= context.joint < body.joint_count:
        raise InputError(
            f"model '{model}' needs joint {context.joint + 1}, but the arm has {body.joint_count} joints"
        )
    return body, context.joint


class RigidBodyModel(BaseModel):
    """tau = M(q) a + C(q, v) v + g(q) without free parameters: residuals show a payload or a wrong mass."""

    name = "rigid_body"
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})

    def build(self, context: ModelContext) -> Model:
        arm_of(context, self.name)
        return Model(self.name, (KnownRigidBody(),))

    def prepare(self, data: ChannelData, context: ModelContext) -> ChannelData:
        return with_rigid_body(data, *arm_of(context, self.name))


class RigidBodyFittedModel(BaseModel):
    """tau = Y(q, v, a) pi + d v, with the base parameters pi that affect the joint's torque."""

    name = "rigid_body_fitted"
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})

    def build(self, context: ModelContext) -> Model:
        body, joint = arm_of(context, self.name)
        arm = base_parameters(body)
        columns = tuple(arm.columns[arm.affects_joint[joint]].tolist())
        return Model(self.name, (RigidBodyFitted(columns, arm, body.parameters), ViscousFriction()))

    def prepare(self, data: ChannelData, context: ModelContext) -> ChannelData:
        body, joint = arm_of(context, self.name)
        arm = base_parameters(body)
        return with_rigid_body(data, body, joint, regressor=arm.columns[arm.affects_joint[joint]])
