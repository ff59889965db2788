"""Keeps a calibration's motions above the ground, and below what the guard trips at.

No part of the arm goes lower than its lowest point at the start.
"""

from collections.abc import Iterable

import numpy as np

from control.arm.rigid_body import RigidBody
from control.paths.trajectory import JointMotion, JointMove
from robot_io.errors import InputError
from robot_io.guard import Limits
from robot_io.types import FloatArray

MARGIN_M = 0.01
_STEP_RAD = 0.05
SHARE = 0.5  # of a limit; the rest is for noise, friction and the controller's corrections
_TORQUE_SHARE = 0.8  # of which the weight, which is known, is the larger part
_TRAVEL_RAD_S = 0.6
ACCELERATION_RAD_S2 = 2.0
_LOOKS = 60  # postures of the way that are looked at
_TRIES = 61  # angles of each joint


def lowest_m(body: RigidBody, postures_rad: Iterable[FloatArray]) -> float:
    """Height [m] of the lowest joint (but the first) or tip over some postures, each (n,) [rad]."""
    return min(float(body.heights_m(posture)[1:].min()) for posture in postures_rad)


def straight_way(start_rad: FloatArray, end_rad: FloatArray) -> FloatArray:
    """Postures on the way of a joint move, shape (k, n) [rad]."""
    count = max(2, int(np.abs(end_rad - start_rad).max() / _STEP_RAD) + 1)
    return np.linspace(start_rad, end_rad, count)


def is_clear(body: RigidBody, postures_rad: Iterable[FloatArray], floor_m: float) -> bool:
    """Whether nothing comes nearer to the floor than the margin, which is where the arm has been already."""
    return lowest_m(body, postures_rad) >= floor_m - MARGIN_M


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


def room(limits: Limits, margin_rad: float) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest positions, (n,) each [rad], that keep a distance from the limits, if they can."""
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
    """Refuse with `InputError` a way up that comes nearer to the ground, or takes too much torque."""
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
