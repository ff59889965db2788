"""Columns of further parameters that belong to the whole arm: the same gain in every joint's torque."""

import numpy as np

from control.arm.rigid_body import PARAMETERS_PER_LINK, RigidBody
from robot_io.calibration.applied import GRAVITY_M_S2
from robot_io.types import FloatArray

PAYLOAD_NAMES = ("mass", "mx", "my", "mz")
PAYLOAD_UNITS = ("kg", "kg m", "kg m", "kg m")
TILT_NAMES = ("pitch", "roll")
TILT_UNITS = ("rad", "rad")


def payload_columns(body: RigidBody, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Torques of a small load held by the last link, per unit of its mass and of its first moments.

    Beside the URDF's masses only: in an arm whose masses are fitted, they are part of the last link's.

    Args:
        body: the arm.
        q: positions of all joints, shape (n, joints) [rad].
        v: velocities, shape (n, joints) [rad/s].
        a: accelerations, shape (n, joints) [rad/s^2].

    Returns:
        Shape (n, joints, 4): per mass [kg] and first moments (x, y, z) [kg m] in the frame of the last
        joint. The load's inertia about that frame is left out.
    """
    last = slice(-PARAMETERS_PER_LINK, -PARAMETERS_PER_LINK + 4)
    return np.stack([body.regressor(*row)[:, last] for row in zip(q, v, a, strict=True)])


def tilt_columns(body: RigidBody, q: FloatArray) -> FloatArray:
    """Torques by which a base that is not level loads the joints, for small angles.

    Args:
        body: the arm, with masses as near as they are known.
        q: positions of all joints, shape (n, joints) [rad].

    Returns:
        Shape (n, joints, 2): change of the torque per radian of pitch and of roll of the base, signs as in
        `robot_io.calibration.applied.gravity_base_m_s2` [N m / rad].
    """
    turned = [
        (GRAVITY_M_S2, 0.0, 0.0),
        (0.0, -GRAVITY_M_S2, 0.0),
    ]  # change of the fall acceleration per radian
    arms = [body.with_gravity(change) for change in turned]
    rest = np.zeros_like(q)
    return np.stack([arm.inverse_dynamics_along(q, rest, rest) for arm in arms], axis=2)
