"""How fast and how hard a calibration moves an arm: below what its guard trips at."""

from collections.abc import Iterable

import numpy as np

from control.arm.rigid_body import RigidBody
from control.paths.trajectory import JointMotion
from robot_io.guard import Limits
from robot_io.types import FloatArray

SHARE = 0.5  # of a limit; the rest is for noise, friction and the controller's corrections
_TORQUE_SHARE = 0.8  # of which the weight, which is known, is the larger part
_TRAVEL_RAD_S = 0.6
ACCELERATION_RAD_S2 = 2.0


def paced(speed_rad_s: float, limits: Limits) -> FloatArray:
    """This speed, or less where a joint's velocity limit asks for that, shape (n,) [rad/s]."""
    return np.minimum(speed_rad_s, SHARE * np.array(limits.velocity_rad_s))


def travel_speed_rad_s(limits: Limits) -> float:
    """Speed of the fastest joint on the ways to where something is measured, and back [rad/s]."""
    return float(paced(_TRAVEL_RAD_S, limits).min())


def overloaded_joint(body: RigidBody, motions: Iterable[JointMotion], limits: Limits) -> int | None:
    """The first joint, from 0, that would need nearly all of its torque limit; None if all is well."""
    for motion in motions:
        share = np.abs(body.inverse_dynamics(*motion)) / np.array(limits.torque_nm)
        if share.max() > _TORQUE_SHARE:
            return int(share.argmax())
    return None
