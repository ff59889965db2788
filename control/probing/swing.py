"""Swings in free air before a run: up from the start of the approach and back down, slowly and fast.

A press moves the joints little and turns them round under load only. What friction, a gap, a lag and a weight
each leave in a joint's torque differs when it turns round in free air, and at two speeds.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from control.arm.rigid_body import RigidBody
from control.paths.joint_way import JointWay
from control.probing.passage import Passage, Passages, Place
from control.probing.plan import ProbingPlan
from control.probing.sites import ProbingSite
from robot_io.errors import InputError
from robot_io.types import FloatArray

_STEPS = 40  # moments of a swing that are looked at
_ROUNDING_M = 1e-6


class Swing(NamedTuple):
    """One half of a swing, up or down.

    Attributes:
        start: where it begins.
        points_rad: from there to its end, at rest in between, shape (3,) each [rad].
        speed_rad_s: of the fastest joint [rad/s].
    """

    start: Place
    points_rad: tuple[FloatArray, ...]
    speed_rad_s: float


def swings_at(site: ProbingSite, near_rad: FloatArray, passages: Passages, plan: ProbingPlan) -> list[Swing]:
    """All swings before a run, in order; none if the plan has none, or the way up dips too near the object.

    Args:
        site: swings begin and end where its next approach starts, and go no higher than it allows.
        near_rad: present joint positions, shape (3,) [rad].
        passages: find the way up.
        plan: how far, and how fast.
    """
    if not plan.free_air_swing_m:
        return []
    low, way = _way_up(site, near_rad, passages, plan)
    if way.too_low_m > 0.0:
        return []
    high, up = Place(way.points_rad[-1], site), way.points_rad
    halves = ((low, up), (high, up[::-1]))
    return [Swing(*half, speed_rad_s) for speed_rad_s in plan.free_air_swing_speeds_rad_s for half in halves]


def check_swings(  # noqa: PLR0917 (all that bounds it)
    sites: Sequence[ProbingSite],
    near_rad: FloatArray,
    passages: Passages,
    plan: ProbingPlan,
    body: RigidBody,
    torque_limits_nm: FloatArray | None,
) -> None:
    """Hold the swings of a plan against the arm: room to be lifted, a way clear of the object, torques.

    Args:
        sites: where the plan presses.
        near_rad: present joint positions, shape (3,) [rad].
        passages: find the way up.
        plan: how far, and how fast.
        body: the arm's dynamics.
        torque_limits_nm: largest torque of each joint, shape (3,) [N m]; None for any.

    Raises:
        InputError: the arm cannot swing so far, or not so fast.
    """
    if not plan.free_air_swing_m:
        return
    for number, site in enumerate(sites, 1):
        what = f"free_air_swing_m {plan.free_air_swing_m:g} m: at target {number}"
        if site.lift_room_m < plan.free_air_swing_m - _ROUNDING_M:
            raise InputError(
                f"{what} the arm can be lifted by {1e3 * site.lift_room_m:.0f} mm only within its joint "
                f"limits; at most {site.lift_room_m:.3g} m"
            )
        low, way = _way_up(site, near_rad, passages, plan)
        if way.too_low_m > 0.0:
            raise InputError(way.problem(f"up from target {number}"))
        near_rad = low.position_rad
        if torque_limits_nm is not None:
            _check_torques(what, way.points_rad, plan, body, torque_limits_nm)


def _way_up(
    site: ProbingSite, near_rad: FloatArray, passages: Passages, plan: ProbingPlan
) -> tuple[Place, Passage]:
    low = Place(site.joint_position_rad(near_rad), site)
    return low, passages.find(low, Place(site.lifted_rad(plan.free_air_swing_m, low.position_rad)))


def _check_torques(
    what: str,
    points_rad: Sequence[FloatArray],
    plan: ProbingPlan,
    body: RigidBody,
    torque_limits_nm: FloatArray,
) -> None:
    speed_rad_s = max(plan.free_air_swing_speeds_rad_s)
    for points in (points_rad, points_rad[::-1]):
        way = JointWay(points, speed_rad_s, plan.joint_acceleration_rad_s2)
        for time_s in np.linspace(0.0, way.duration_s, _STEPS):
            torque_nm = np.abs(body.inverse_dynamics(*way.at(float(time_s))))
            joint = int((torque_nm / torque_limits_nm).argmax())
            if torque_nm[joint] > torque_limits_nm[joint]:
                raise InputError(
                    f"{what} joint {joint + 1} would need {torque_nm[joint]:.3g} N m, its limit is "
                    f"{torque_limits_nm[joint]:g} N m (limits.torque_nm): swing less far or slower, or with "
                    "less joint_acceleration_rad_s2"
                )
