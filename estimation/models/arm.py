"""Finds the arm and the joint that a rigid-body model is about."""

import numpy as np
from scipy.linalg import qr

from control.arm.rigid_body import RigidBody
from estimation.base_model import ModelContext
from robot_io.errors import InputError

_POSTURES = 200
_INDEPENDENT = 1e-8  # of the largest diagonal, below which a column depends on those before it


def arm_of(context: ModelContext, model: str) -> tuple[RigidBody, int]:
    """The arm, and the number of the joint from 0.

    Raises:
        InputError: the context names no URDF or no joint, or a joint that the arm does not have.
    """
    if not context.urdf or context.joint is None:
        raise InputError(f"model '{model}' needs a joint channel and the arm's URDF (--urdf FILE)")
    body = RigidBody.from_urdf(
        context.urdf, context.tip_frame, context.gravity_m_s2, origin=context.urdf_origin
    )
    if not 0 <= context.joint < body.joint_count:
        raise InputError(f"model '{model}': joint {context.joint + 1}, but the arm has {body.joint_count}")
    return body, context.joint


def base_columns(body: RigidBody, joint: int) -> tuple[int, ...]:
    """Columns of the regressor that one joint's torque can tell apart, whatever the motion."""
    rng = np.random.default_rng(0)
    motions = rng.uniform(-2.0, 2.0, (_POSTURES, 3, body.joint_count))
    rows = np.array([body.regressor(*motion)[joint] for motion in motions])
    triangle, order = qr(rows, mode="r", pivoting=True)
    size = np.abs(np.diag(triangle))
    return tuple(sorted(int(i) for i in order[: int(np.sum(size > _INDEPENDENT * size[0]))]))
