"""Where the joints' hard stops are touched: which side, and in which posture the arm is clear meanwhile."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from calibration.arm.room import (
    MARGIN_M,
    check_way_up,
    highest_posture,
    lowest_m,
    overloaded_joint,
    room,
    straight_way,
)
from control.arm.rigid_body import RigidBody
from control.paths.trajectory import JointMotion
from robot_io.errors import InputError
from robot_io.guard import Limits
from robot_io.types import FloatArray

_NEAR_RAD = 0.12  # the approach begins so far before the stop
_LIMIT_MARGIN_RAD = 0.1  # postures stay so far from the position limits
_INSTEAD = "or calibrate in a known pose instead, without power: --pose home"
_TRIES = 5  # postures of each other joint


@dataclass(frozen=True)
class StopApproach:
    """One joint's way to its stop."""

    joint: int  # from 0
    stop_rad: float  # where the stop is said to be [rad]
    side: int  # 1 for the upper stop, -1 for the lower
    posture_rad: FloatArray  # where the approach begins, shape (n,) [rad]


def plan_stops(
    body: RigidBody,
    start_rad: FloatArray,
    limits: Limits,
    stops_rad: tuple[FloatArray, FloatArray],
    reach_rad: float,
) -> tuple[FloatArray, tuple[StopApproach, ...]]:
    """The posture to go up to first, and the approaches, each from there.

    For each joint the side and posture with the most room to the ground are taken, of those in which the
    torque limits carry the arm. Nothing goes lower than where the arm stands, `start_rad` (n,). Stops are
    lower and upper ones, (n,) each, NaN where there is none; a joint may seem to go `reach_rad` beyond.

    InputError: a joint has no stop that can be reached clear of the ground.
    """
    floor_m = float(body.heights_m(start_rad)[1:].min())
    low, high = room(limits, _LIMIT_MARGIN_RAD)
    up = highest_posture(body, low, high)
    check_way_up(body, start_rad, up, limits)
    approaches = []
    for joint in range(body.joint_count):
        ways = _candidates(body, up, joint, bounds=(low, high), stops_rad=stops_rad, reach_rad=reach_rad)
        candidates = ((lowest_m(body, way), it) for way, it in ways if _carried(body, way, limits))
        lowest, approach = max(candidates, key=lambda found: found[0], default=(None, None))
        if lowest is None or approach is None:
            raise InputError(
                f"joint {joint + 1}: no stop of it is stated, or limits.torque_nm hardly carry the arm "
                f"there: state or raise them; {_INSTEAD}"
            )
        if lowest < floor_m - MARGIN_M:
            raise InputError(
                f"joint {joint + 1}: on the way to its stops the arm would come {floor_m - lowest:.2g} m "
                f"nearer to the ground than it stands now: begin with it so much higher; {_INSTEAD}"
            )
        approaches.append(approach)
    return up, tuple(approaches)


def with_room_for_stops(limits: Limits, approaches: Iterable[StopApproach], beyond_rad: float) -> Limits:
    """The limits with room for each joint to go to its stop, and to seem `beyond_rad` farther."""
    low, high = list(limits.position_min_rad), list(limits.position_max_rad)
    for approach in approaches:
        joint, end_rad = approach.joint, approach.stop_rad + approach.side * beyond_rad
        if approach.side > 0:
            high[joint] = max(high[joint], end_rad)
        else:
            low[joint] = min(low[joint], end_rad)
    return limits.model_copy(update={"position_min_rad": tuple(low), "position_max_rad": tuple(high)})


def _carried(body: RigidBody, way_rad: FloatArray, limits: Limits) -> bool:
    at_rest = np.zeros(body.joint_count)
    return overloaded_joint(body, (JointMotion(q, at_rest, at_rest) for q in way_rad), limits) is None


def _candidates(
    body: RigidBody,
    up: FloatArray,
    joint: int,
    *,
    bounds: tuple[FloatArray, FloatArray],
    stops_rad: tuple[FloatArray, FloatArray],
    reach_rad: float,
) -> Iterator[tuple[FloatArray, StopApproach]]:
    """Postures on the way, (k, n), and approach, for both sides and some postures of the joints behind."""
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
            yield way, StopApproach(joint, float(stops[joint]), side, posture)
