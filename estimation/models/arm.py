"""Finds the arm and the joint that a rigid-body model is about."""

from typing import TYPE_CHECKING

from estimation.base_model import ModelContext
from robot_io.errors import InputError

if TYPE_CHECKING:
    from control.arm.rigid_body import RigidBody


def arm_of(context: ModelContext, model: str) -> tuple["RigidBody", int]:
    """The arm, and the number of the joint from 0.

    Raises:
        InputError: the context names no URDF or no joint, or a joint that the arm does not have.
    """
    if not context.urdf or context.joint is None:
        raise InputError(f"model '{model}' needs a joint channel and the arm's URDF (--urdf FILE)")
    from control.arm.rigid_body import RigidBody  # noqa: PLC0415, needs Pinocchio

    body = RigidBody.from_urdf(
        context.urdf,
        context.tip_frame,
        context.gravity_m_s2,
        context.rotor_inertia_kg_m2,
        origin=context.urdf_origin,
    )
    if not 0 <= context.joint < body.joint_count:
        raise InputError(f"model '{model}': joint {context.joint + 1}, but the arm has {body.joint_count}")
    return body, context.joint
