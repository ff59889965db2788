"""Limits of a calibration's motions: above the ground, and below what the guard trips at.

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
_TORQUE_SHARE = 0.8  # share of the torque limit, mostly for the known weight
_TRAVEL_RAD_S = 0.6
ACCELERATION_RAD_S2 = 2.0
_POSTURES = 60  # postures of the way that are checked
_TRIES = 61  # angles of each joint


def lowest_m(body: RigidBody, postures_rad: Iterable[FloatArray]) -> float:
    """Compute the height of the lowest joint (but the first) or tip over some postures.

    Args:
        body: model of the arm.
        postures_rad: joint positions, shape (n,) each [rad].

    Returns:
        Height [m].
    """
    return min(float(body.heights_m(posture)[1:].min()) for posture in postures_rad)


def straight_way(start_rad: FloatArray, end_rad: FloatArray) -> FloatArray:
    """List postures on the way of a joint move.

    Args:
        start_rad: shape (n,) [rad].
        end_rad: shape (n,) [rad].

    Returns:
        Shape (k, n) [rad].
    """
    count = max(2, int(np.abs(end_rad - start_rad).max() / _STEP_RAD) + 1)
    return np.linspace(start_rad, end_rad, count)


def is_clear(body: RigidBody, postures_rad: Iterable[FloatArray], floor_m: float) -> bool:
    """Whether no part comes nearer to the floor than the margin.

    Args:
        body: model of the arm.
        postures_rad: joint positions, shape (n,) each [rad].
        floor_m: height of the floor, which the arm has reached already [m].

    Returns:
        True if all postures are clear.
    """
    return lowest_m(body, postures_rad) >= floor_m - MARGIN_M


def paced(speed_rad_s: float, limits: Limits) -> FloatArray:
    """Limit a speed to a share of the joints' velocity limits.

    Args:
        speed_rad_s: intended speed [rad/s].
        limits: of the guard.

    Returns:
        Speed of each joint, shape (n,) [rad/s].
    """
    return np.minimum(speed_rad_s, SHARE * np.array(limits.velocity_rad_s))


def travel_speed_rad_s(limits: Limits) -> float:
    """Compute the speed of the fastest joint on the ways to a measurement and back.

    Args:
        limits: of the guard.

    Returns:
        Speed [rad/s].
    """
    return float(paced(_TRAVEL_RAD_S, limits).min())


def overloaded_joint(body: RigidBody, motions: Iterable[JointMotion], limits: Limits) -> int | None:
    """Find the first joint that would need nearly all of its torque limit.

    Args:
        body: model of the arm.
        motions: of all joints.
        limits: of the guard.

    Returns:
        Index of the joint from 0; None if there is none.
    """
    for motion in motions:
        share = np.abs(body.inverse_dynamics(*motion)) / np.array(limits.torque_nm)
        if share.max() > _TORQUE_SHARE:
            return int(share.argmax())
    return None


def room(limits: Limits, margin_rad: float) -> tuple[FloatArray, FloatArray]:
    """Compute the position range that keeps a distance from the limits.

    Args:
        limits: of the guard.
        margin_rad: distance [rad].

    Returns:
        Lowest and highest positions, shape (n,) each [rad].

    Raises:
        InputError: a joint's range is too small.
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
    """Check that the way up keeps its distance from the ground, and that the torque limits carry the arm.

    Args:
        body: model of the arm.
        start_rad: present joint positions, shape (n,) [rad].
        up_rad: end of the way, shape (n,) [rad].
        limits: of the guard.

    Raises:
        InputError: the way comes nearer to the ground, or needs too much torque.
    """
    floor_m = float(body.heights_m(start_rad)[1:].min())
    if not is_clear(body, straight_way(start_rad, up_rad), floor_m):
        raise InputError(
            "the way up from where the arm stands would come nearer to the ground: raise the arm first"
        )
    move = JointMove(start_rad, up_rad, travel_speed_rad_s(limits), ACCELERATION_RAD_S2)
    motions = (move.at(time_s) for time_s in np.linspace(0.0, move.duration_s, _POSTURES))
    joint = overloaded_joint(body, motions, limits)
    if joint is not None:
        raise InputError(
            f"joint {joint + 1}: its limits.torque_nm, {limits.torque_nm[joint]:g} N m, hardly carries the "
            "arm on its way up: raise it, or correct the URDF's masses"
        )


def highest_posture(body: RigidBody, low: FloatArray, high: FloatArray) -> FloatArray:
    """Find the posture whose joints and tip stand highest, on a grid over the joints' ranges.

    Args:
        body: model of the arm.
        low: lowest positions, shape (n,) [rad].
        high: highest positions, shape (n,) [rad].

    Returns:
        Joint positions, shape (n,) [rad].
    """
    posture = np.clip(np.zeros(body.joint_count), low, high)
    for _ in range(2):  # joint by joint: for a chain the sum of heights has one top
        for joint in range(body.joint_count):
            tries = np.repeat(posture[None], _TRIES, axis=0)
            tries[:, joint] = np.linspace(low[joint], high[joint], _TRIES)
            posture = max(tries, key=lambda q: float(body.heights_m(q).sum()))
    return posture
