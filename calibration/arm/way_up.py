"""The way from where an arm stands to the posture in which it has room to move."""

import numpy as np

from calibration.arm.clearance import is_clear, straight_way
from calibration.arm.pace import ACCELERATION_RAD_S2, overloaded_joint, travel_speed_rad_s
from control.arm.rigid_body import RigidBody
from control.paths.trajectory import JointMove
from robot_io.errors import InputError
from robot_io.guard import Limits
from robot_io.types import FloatArray

_LOOKS = 60  # postures of the way that are looked at
_TRIES = 61  # angles of each joint


def room(limits: Limits, margin_rad: float) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest positions, (n,) each [rad], that keep a distance from the limits.

    Raises:
        InputError: a joint's limits leave nothing.
    """
    low = np.array(limits.position_min_rad) + margin_rad
    high = np.array(limits.position_max_rad) - margin_rad
    if np.any(low >= high):
        joint = int(np.argmax(low - high))
        raise InputError(
            f"joint {joint + 1}: limits.position_min_rad and position_max_rad are "
            f"{high[joint] - low[joint] + 2 * margin_rad:.3g} rad apart; a calibration keeps "
            f"{margin_rad:g} rad away from both: widen them"
        )
    return low, high


def check_way_up(body: RigidBody, start_rad: FloatArray, up_rad: FloatArray, limits: Limits) -> None:
    """Refuse a way up that would touch what is below the arm, or that the guard would stop.

    Raises:
        InputError: it comes nearer to the ground than where it starts, or takes too much torque.
    """
    floor_m = float(body.heights_m(start_rad)[1:].min())
    if not is_clear(body, straight_way(start_rad, up_rad), floor_m):
        raise InputError(
            "the way up from where the arm stands would come nearer to the ground: raise the arm first"
        )
    move = JointMove(start_rad, up_rad, travel_speed_rad_s(limits), ACCELERATION_RAD_S2)
    motions = (move.at(time_s) for time_s in np.linspace(0.0, move.duration_s, _LOOKS))
    joint = overloaded_joint(body, motions, limits)
    if joint is not None:
        raise InputError(
            f"joint {joint + 1}: its limits.torque_nm, {limits.torque_nm[joint]:g} N m, hardly carries the "
            "arm on its way up: raise it, or correct the URDF's masses"
        )


def highest_posture(body: RigidBody, low: FloatArray, high: FloatArray) -> FloatArray:
    """Of a grid over the joints' ranges the posture whose joints and tip stand highest, shape (n,) [rad]."""
    posture = np.clip(np.zeros(body.joint_count), low, high)
    for _ in range(2):  # joint by joint: for a chain the sum of heights has one top
        for joint in range(body.joint_count):
            tries = np.repeat(posture[None], _TRIES, axis=0)
            tries[:, joint] = np.linspace(low[joint], high[joint], _TRIES)
            posture = max(tries, key=lambda q: float(body.heights_m(q).sum()))
    return posture
