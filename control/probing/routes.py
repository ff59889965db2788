"""Routes in free air that stay above the object, and the swings before a run.

A proportional motion of the joints moves the tip along an arc. Between two targets the arc can sag by
centimeters, more than the lift of the tool between runs. If the tip would come too low, it is lifted first.

A press moves the joints little and reverses them only under load. Friction, backlash, lag and weight have
different effects on a joint's torque when the joint reverses in free air, and at two speeds. Therefore the
arm can swing up from the start of the approach and back down, slowly and fast.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from palpate.control.arm.inverse_kinematics import PlanarArm
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.paths.trajectory import JointPath
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.sites import ProbingSite
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

_STEPS = 40  # checked points of a route, and checked times of a swing
_MIN_CLEARANCE_SHARE = 0.5  # share of the clearance that a route must keep
_MAX_LIFTS = 5  # attempts to lift a route
_LIFT_MARGIN_M = 0.002
_ROUNDING_M = 1e-6


class RouteEnd(NamedTuple):
    """End of a route: joint positions, shape (3,) [rad], and the site whose approach starts there.

    Without a site the tip cannot be lifted along a press line.
    """

    position_rad: FloatArray
    site: ProbingSite | None = None


class Route(NamedTuple):
    """Points, shape (3,) each [rad], with rest in between, and how much too low the lowest one is [m]."""

    points_rad: tuple[FloatArray, ...]
    clearance_deficit_m: float

    def problem(self, where: str) -> str:
        """Describe that the route is too low, with a remedy.

        Args:
            where: part of the route for messages, such as "to target 2".
        """
        return (
            f"on the way {where} the tip would come {1e3 * self.clearance_deficit_m:.1f} mm too close to the "
            "object and cannot be lifted further; move the targets closer together, or increase "
            "approach_clearance_m and retract_m"
        )


def _refuse_if_low(route: Route, where: str) -> None:
    if route.clearance_deficit_m > 0.0:
        raise InputError(route.problem(where))


class Swing(NamedTuple):
    """Half a swing, up or down: start, further points, shape (3,) each [rad], and fastest joint's speed."""

    start: RouteEnd
    points_rad: tuple[FloatArray, ...]
    speed_rad_s: float


class Routes:
    """Finds routes and swings for a plan, whose press direction is "down".

    Args:
        arm: geometry of the arm.
        plan: press direction and clearances.
    """

    def __init__(self, arm: PlanarArm, plan: ProbingPlan) -> None:
        self._arm, self._plan = arm, plan
        u, w, _ = arm.plane_direction(np.array(plan.press_direction_world))
        self._down = np.array((u, w))
        self._spare_m = (1.0 - _MIN_CLEARANCE_SHARE) * min(plan.retract_m, plan.approach_clearance_m)
        self._shares = np.linspace(0.0, 1.0, _STEPS)[:, None]

    def find(self, start: RouteEnd, end: RouteEnd) -> Route:
        """Find the route with the smallest lift that clears the object, or else the highest route.

        The clearance refers to the higher of two targets, or else to the lower end of the route.

        Args:
            start: end at which the arm rests, with its target if it is over one.
            end: the same for the other end.
        """
        ends = (start, end)
        depths_m = self._depths_m(np.array([start.position_rad, end.position_rad]))
        top_m = float(depths_m.min() if start.site and end.site else depths_m.max())
        best, level_m = self._at_level(ends, math.inf, top_m), top_m
        for _ in range(_MAX_LIFTS):
            if best.clearance_deficit_m <= 0.0:
                break
            route = self._at_level(ends, level_m, top_m)
            level_m -= max(route.clearance_deficit_m, 0.0) + _LIFT_MARGIN_M
            best = min(best, route, key=lambda candidate: candidate.clearance_deficit_m)
        return best

    def check(
        self,
        start: RouteEnd,
        sites: Sequence[ProbingSite],
        body: RigidBody,
        torque_limits_nm: FloatArray | None,
    ) -> None:
        """Check the routes from the start to all sites in order and back, and the plan's swings.

        Args:
            start: present place of the arm.
            sites: sites of the plan, in order.
            body: model of the arm.
            torque_limits_nm: largest torques, shape (3,) [N m]; None for any.

        Raises:
            InputError: the tip comes too near to an expected object, or the arm has not enough room or torque
                for a swing; the error names a remedy.
        """
        place, where, near_rad, plan = start, "", start.position_rad, self._plan
        for number, site in enumerate(sites, 1):
            place, previous = RouteEnd(site.joint_position_rad(place.position_rad), site), place
            where = f"target {number}"
            _refuse_if_low(self.find(previous, place), f"to {where}")
        _refuse_if_low(self.find(place, start), f"back from {where}")
        if not plan.free_air_swing_m:
            return
        for number, site in enumerate(sites, 1):
            what = f"free_air_swing_m {plan.free_air_swing_m:g} m: at target {number}"
            if site.lift_room_m < plan.free_air_swing_m - _ROUNDING_M:
                raise InputError(f"{what} the joint limits allow a lift of at most {site.lift_room_m:.3g} m")
            low, up = self._lift_path(site, near_rad)
            _refuse_if_low(up, f"up from target {number}")
            near_rad = low.position_rad
            if torque_limits_nm is None:
                continue
            speed_rad_s = max(plan.free_air_swing_speeds_rad_s)
            for points in (up.points_rad, up.points_rad[::-1]):
                path = JointPath(points, speed_rad_s, plan.joint_acceleration_rad_s2)
                for time_s in np.linspace(0.0, path.duration_s, _STEPS):
                    torque_nm = np.abs(body.inverse_dynamics(*path.at(float(time_s))))
                    joint = int((torque_nm / torque_limits_nm).argmax())
                    if torque_nm[joint] > torque_limits_nm[joint]:
                        raise InputError(
                            f"{what} joint {joint + 1} would need {torque_nm[joint]:.3g} N m, but its limit "
                            f"is {torque_limits_nm[joint]:g} N m (limits.torque_nm); swing less far or more "
                            "slowly, or lower joint_acceleration_rad_s2"
                        )

    def swings_at(self, site: ProbingSite, near_rad: FloatArray) -> list[Swing]:
        """List all swings before a run at a site.

        Args:
            site: site of the next approach start, where all swings begin and end.
            near_rad: present joint positions, shape (3,) [rad].

        Returns:
            Half swings in order; empty if the plan has none, or the path up is too near to the object.
        """
        if not self._plan.free_air_swing_m:
            return []
        low, up = self._lift_path(site, near_rad)
        if up.clearance_deficit_m > 0.0:
            return []
        halves = ((low, up.points_rad), (RouteEnd(up.points_rad[-1], site), up.points_rad[::-1]))
        return [Swing(*half, speed) for speed in self._plan.free_air_swing_speeds_rad_s for half in halves]

    def _lift_path(self, site: ProbingSite, near_rad: FloatArray) -> tuple[RouteEnd, Route]:
        low = RouteEnd(site.joint_position_rad(near_rad), site)
        high_rad = site.lifted_rad(self._plan.free_air_swing_m, low.position_rad)
        return low, self.find(low, RouteEnd(high_rad))

    def _at_level(self, ends: tuple[RouteEnd, RouteEnd], level_m: float, top_m: float) -> Route:
        """Return the route with lower ends lifted to a level [m], as far as the sites allow it."""
        start, end = ends
        above_start, above_end = self._lifted_rad(start, level_m), self._lifted_rad(end, level_m)
        points_rad = above_start + self._shares * (above_end - above_start)
        clearance_deficit_m = float(self._depths_m(points_rad).max()) - top_m - self._spare_m
        points = [start.position_rad]
        points += [above_start] if above_start is not start.position_rad else []
        points += [above_end] if above_end is not end.position_rad else []
        return Route((*points, end.position_rad), max(clearance_deficit_m, 0.0))

    def _lifted_rad(self, place: RouteEnd, level_m: float) -> FloatArray:
        if place.site is None:
            return place.position_rad
        lift_m = float(self._depths_m(place.position_rad[None])[0]) - level_m
        if lift_m <= _ROUNDING_M:
            return place.position_rad
        return place.site.lifted_rad(lift_m, place.position_rad)

    def _depths_m(self, position_rad: FloatArray) -> FloatArray:
        """Return the tip's depth along "down", shape (k,) [m], for joint positions of shape (k, 3) [rad]."""
        return np.asarray(self._arm.tips_in_plane(position_rad) @ self._down)
