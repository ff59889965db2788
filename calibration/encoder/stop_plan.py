"""Where the joints' hard stops are touched: which side, and in which posture the arm is clear meanwhile."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from calibration.arm.clearance import is_clear, lowest_m, straight_way
from calibration.arm.excitation import highest_posture
from control.arm.rigid_body import RigidBody
from robot_io.errors import InputError
from robot_io.limits import Limits
from robot_io.types import FloatArray

_NEAR_RAD = 0.12  # the approach begins so far before the stop
_TRIES = 5  # postures of each other joint


@dataclass(frozen=True)
class StopApproach:
    """One joint's way to its stop.

    Attributes:
        joint: from 0.
        stop_rad: where the stop is said to be [rad].
        side: 1 for the upper stop, -1 for the lower.
        posture_rad: where the approach begins, shape (n,) [rad].
    """

    joint: int
    stop_rad: float
    side: int
    posture_rad: FloatArray


def plan_stops(
    body: RigidBody,
    start_rad: FloatArray,
    limits: Limits,
    stops_rad: tuple[FloatArray, FloatArray],
    reach_rad: float,
) -> tuple[FloatArray, tuple[StopApproach, ...]]:
    """The posture to go up to first, and the approaches, each from there.

    For each joint the side and posture with the most room to the ground are taken.

    Args:
        body: the arm.
        start_rad: where the arm stands, shape (n,) [rad]; nothing goes lower than it does there.
        limits: of position; approaches begin within them.
        stops_rad: lower and upper hard stops, (n,) each [rad]; NaN where there is none.
        reach_rad: how far beyond a stop the joint may seem to go [rad].

    Raises:
        InputError: a joint has no stop that can be reached clear of the ground.
    """
    floor_m = float(body.heights_m(start_rad)[1:].min())
    low, high = np.array(limits.position_min_rad) + 0.1, np.array(limits.position_max_rad) - 0.1
    up = highest_posture(body, low, high)
    if not is_clear(body, straight_way(start_rad, up), floor_m):
        raise InputError(
            "the way up from where the arm stands would come nearer to the ground: raise the arm first"
        )
    approaches = []
    for joint in range(body.joint_count):
        best = max(
            _candidates(body, up, joint, bounds=(low, high), stops_rad=stops_rad, reach_rad=reach_rad),
            key=lambda found: found[0],
            default=None,
        )
        if best is None or best[0] < floor_m:
            raise InputError(
                f"joint {joint + 1}: neither stop can be reached without coming nearer to the ground than "
                "the arm stands now; use a known pose instead (--pose)"
            )
        approaches.append(best[1])
    return up, tuple(approaches)


def _candidates(
    body: RigidBody,
    up: FloatArray,
    joint: int,
    *,
    bounds: tuple[FloatArray, FloatArray],
    stops_rad: tuple[FloatArray, FloatArray],
    reach_rad: float,
) -> Iterator[tuple[float, StopApproach]]:
    """Lowest point and approach, for both sides and some postures of the joints behind this one."""
    low, high = bounds
    behind = [np.linspace(0.6 * low[j], 0.6 * high[j], _TRIES) for j in range(joint + 1, body.joint_count)]
    for side, stops in ((-1, stops_rad[0]), (1, stops_rad[1])):
        if not np.isfinite(stops[joint]):
            continue
        for others in product(*behind):
            posture = up.copy()
            posture[joint + 1 :] = others
            posture[joint] = np.clip(stops[joint] - side * _NEAR_RAD, low[joint], high[joint])
            end = posture.copy()
            end[joint] = stops[joint] + side * reach_rad
            way = np.concatenate([straight_way(up, posture), straight_way(posture, end)])
            yield lowest_m(body, way), StopApproach(joint, float(stops[joint]), side, posture)
