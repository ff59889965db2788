"""Chooses a motion for an arm: inside its limits, clear of the ground, and telling as much as it can."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.arm.clearance import is_clear
from calibration.arm.fourier import FourierPath
from calibration.arm.model import GravityBodies, design
from calibration.arm.pace import SHARE, overloaded_joint, paced
from calibration.arm.way_up import check_way_up, highest_posture, room
from control.arm.rigid_body import RigidBody
from control.paths.trajectory import JointMotion
from robot_io.errors import InputError
from robot_io.guard import Limits
from robot_io.types import FloatArray

HARMONICS = 4
_SLOWEST_RAD_S = 0.1  # friction near standstill hides the torques of slower motions
_LIMIT_MARGIN_RAD = 0.15  # stays so far from the position limits
_CANDIDATES = 24
_LOOKS = 120  # postures of a candidate that are looked at
_SHRINKING = (1.0, 0.8, 0.6, 0.45, 0.3, 0.2)


@dataclass(frozen=True)
class ExcitationWish:
    """What kind of motion is wanted.

    Attributes:
        duration_s: of the whole motion [s].
        period_s: of its slowest part [s].
        amplitude_rad: of a joint, if nothing is in the way [rad].
        speed_rad_s: of the fastest joint at most [rad/s].
    """

    duration_s: float
    period_s: float
    amplitude_rad: float = 1.0
    speed_rad_s: float = 1.5


TORQUE_WISH = ExcitationWish(duration_s=40.0, period_s=10.0)
GRAVITY_WISH = ExcitationWish(duration_s=60.0, period_s=30.0, speed_rad_s=0.4)


def choose_path(
    body: RigidBody,
    bodies: GravityBodies,
    start_rad: FloatArray,
    limits: Limits,
    *,
    wish: ExcitationWish,
    rng: np.random.Generator,
) -> FourierPath:
    """The most telling of some random paths about the posture that stands highest.

    Telling is the determinant of the normal equations (D-optimal) of gains, offsets, friction and tilt.

    Args:
        body: the arm.
        bodies: its parts for the model.
        start_rad: where the arm stands, shape (n,) [rad]; nothing goes lower than it does there.
        limits: of position, velocity and torque.
        wish: duration and speed.
        rng: for the candidates; equal seeds choose the same path.

    Raises:
        InputError: no motion is clear of the ground and inside the limits, or all are too slow to tell.
    """
    floor_m = float(body.heights_m(start_rad)[1:].min())
    low, high = room(limits, _LIMIT_MARGIN_RAD)
    speed = _told_speeds(limits, wish)
    centre = highest_posture(body, low, high)
    check_way_up(body, start_rad, centre, limits)
    times = np.linspace(0.0, wish.duration_s, _LOOKS)
    best: tuple[float, FourierPath] | None = None
    for _ in range(_CANDIDATES):
        shape = (
            rng.uniform(0.3, 1.0, (body.joint_count, HARMONICS)),
            rng.uniform(-math.pi, math.pi, (body.joint_count, HARMONICS)),
        )
        for path in _shrinking(centre, shape, wish, (low, high), speed):
            motions = [path.at(time_s) for time_s in times]
            clear = is_clear(body, (motion.position_rad for motion in motions), floor_m)
            if clear and overloaded_joint(body, motions, limits) is None:
                score = _telling(bodies, motions)
                best = (score, path) if best is None or score > best[0] else best
                break
    if best is None:
        raise InputError(
            "no motion of the arm stays above where it stands now and within its torque limits: "
            "raise the arm first, or limits.torque_nm"
        )
    return best[1]


def _told_speeds(limits: Limits, wish: ExcitationWish) -> FloatArray:
    """Speeds that the joints may have, shape (n,) [rad/s].

    Raises:
        InputError: a joint may only move so slowly that its torque says nothing.
    """
    speed = paced(wish.speed_rad_s, limits)
    joint = int(speed.argmin())
    if speed[joint] < _SLOWEST_RAD_S:
        raise InputError(
            f"limits.velocity_rad_s of joint {joint + 1} is {limits.velocity_rad_s[joint]:g} rad/s: too slow "
            f"to tell friction from weight; this motion needs {_SLOWEST_RAD_S / SHARE:g} rad/s or more"
        )
    return speed


def _shrinking(
    centre: FloatArray,
    shape: tuple[FloatArray, FloatArray],
    wish: ExcitationWish,
    bounds: tuple[FloatArray, FloatArray],
    speed: FloatArray,
) -> Iterator[FourierPath]:
    """One path, smaller and smaller; each inside the limits of position and speed."""
    (low, high), (amplitude, phase) = bounds, shape
    period_s = wish.period_s
    times = np.linspace(0.0, wish.duration_s, 10 * _LOOKS)
    unit = FourierPath(np.zeros(len(centre)), amplitude, phase, period_s, wish.duration_s)
    motions = [unit.at(time_s) for time_s in times]
    reach = np.abs([motion.position_rad for motion in motions]).max(axis=0)
    rate = np.abs([motion.velocity_rad_s for motion in motions]).max(axis=0)
    room = np.minimum(np.minimum(high - centre, centre - low), wish.amplitude_rad)
    scale = np.minimum(room / reach, speed / rate)
    for share in _SHRINKING:
        yield FourierPath(centre, share * scale[:, None] * amplitude, phase, period_s, wish.duration_s)


def _telling(bodies: GravityBodies, motions: Sequence[JointMotion]) -> float:
    q, v, a = (np.array(part) for part in zip(*motions, strict=True))
    columns = design(bodies, q, v, a)
    norms = np.linalg.norm(columns, axis=0)
    sign, size = np.linalg.slogdet(columns[:, norms > 0].T @ columns[:, norms > 0])
    return float(size) if sign > 0 else -math.inf
