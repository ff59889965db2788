"""Sites of a probing plan: one press line per target, checked against the arm before it moves."""

from dataclasses import dataclass

import numpy as np

from palpate.control.arm.inverse_kinematics import PlanarArm
from palpate.control.paths.press_line import PressLine
from palpate.control.paths.trajectory import LineState, blend_distance_m
from palpate.control.probing.plan import ProbingPlan
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import FloatArray, frozen_array

JointLimits = tuple[FloatArray, FloatArray]
_LIFT_ROOM_M = 0.1  # smallest lift above the highest target's clearance, for the move to the next target
_FORCE_MARGIN = 1.1  # margin for the overshoot of touch and loading
_SPEED_MARGIN = 1.1  # margin for the encoder's noise and the controller's corrections
_TURNED_RAD = 0.5  # turn of a joint from which the tool does not point along the press line
_STEPS = 20  # checked points of a press line


@dataclass
class ProbingSite:
    """A target: its press line, and limits as travels along that line [m]."""

    line: PressLine
    search_travel_m: float  # travel before which the surface must be touched
    deepest_travel_m: float  # largest travel of the tip
    highest_travel_m: float  # smallest travel at which an approach may start, not positive
    lifted_travel_m: float  # smallest travel of the tip, not above `highest_travel_m`
    approach_travel_m: float = 0.0  # travel at which the next approach starts; 0 until the surface is known

    @property
    def lift_room_m(self) -> float:
        """Possible lift of the tip from the start of the next approach [m]."""
        return self.approach_travel_m - self.lifted_travel_m

    def joint_position_rad(self, near_rad: FloatArray) -> FloatArray:
        """Compute the joint positions at the start of the approach, shape (3,) [rad].

        Args:
            near_rad: joint positions whose nearest turns are taken, shape (3,) [rad].
        """
        return self.line.joint_motion(LineState(self.approach_travel_m), near_rad).position_rad

    def lifted_rad(self, lift_m: float, near_rad: FloatArray) -> FloatArray:
        """Compute the joint positions with the tip lifted, shape (3,) [rad].

        Args:
            lift_m: height above the start of the approach [m]; clipped to the highest possible.
            near_rad: joint positions whose nearest turns are taken, shape (3,) [rad].
        """
        travel_m = max(self.approach_travel_m - lift_m, self.lifted_travel_m)
        return self.line.joint_motion(LineState(travel_m), near_rad).position_rad


def probing_sites(
    arm: PlanarArm,
    plan: ProbingPlan,
    tip_position_world_m: FloatArray,
    position_rad: FloatArray,
    limits_rad: JointLimits,
    *,
    velocity_limits_rad_s: FloatArray | None = None,
) -> list[ProbingSite]:
    """Compute the sites of all targets, with the elbow on its present side, and check their speeds.

    Args:
        arm: geometry of the arm.
        plan: targets and distances; without targets, a single approach starts at the tip.
        tip_position_world_m: present tip position, shape (3,) [m].
        position_rad: present joint positions, shape (3,) [rad].
        limits_rad: lowest and highest joint positions, shape (3,) each [rad].
        velocity_limits_rad_s: the guard's velocity limits, shape (3,) [rad/s]; None for any.

    Raises:
        InputError: an approach start or the search distance after it is out of reach, or the guard would trip
            on a press line; the error then names the largest valid speed.
    """
    direction = frozen_array(plan.press_direction_world)
    starts = [frozen_array(target) - plan.approach_clearance_m * direction for target in plan.targets_world_m]
    elbow = arm.elbow_of(position_rad)
    approach_starts = starts or [tip_position_world_m]
    highest_m = min(float(start @ direction) for start in approach_starts)
    room_m = max(_LIFT_ROOM_M, plan.free_air_swing_m)
    sites = []
    for number, start in enumerate(approach_starts, 1):
        millimeters = ", ".join(f"{1e3 * value:.0f}" for value in start)
        name = f"target {number} ({millimeters} mm)" if starts else "below the tip"
        try:
            line = PressLine(arm, start, direction, elbow)
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
        if line.start.near_singular:
            raise InputError(f"{name}: the arm would be stretched or folded (singular); move the target")
        lift_m = float(start @ direction) - highest_m + room_m
        deepest_m = line.reach_m(plan.search_depth_m + plan.max_depth_m, position_rad, limits_rad)
        clearance_m = max(plan.retract_m, plan.approach_clearance_m)
        lifted_m = line.reach_m(-clearance_m - lift_m, position_rad, limits_rad)
        search_m = min(plan.search_depth_m, deepest_m)
        run_up_m = blend_distance_m(max(plan.speeds_m_s), plan.acceleration_m_s2)
        if search_m <= run_up_m:
            turn_rad = line.joint_motion(LineState(0.0), position_rad).position_rad - position_rad
            joint = int(np.abs(turn_rad).argmax())
            turned = ""
            if not starts and abs(turn_rad[joint]) > _TURNED_RAD:
                turned = (
                    f". To push in this direction, the tool must first turn (joint {joint + 1} by "
                    f"{turn_rad[joint]:+.2f} rad); if it points there already, correct sensor_axis_tip"
                )
            raise InputError(
                f"{name}: within its joint limits the arm can move only {deepest_m * 1e3:.0f} mm beyond "
                f"the start of the approach, but it needs more than {run_up_m * 1e3:.1f} mm to reach its "
                f"speed{turned}"
            )
        site = ProbingSite(line, search_m, deepest_m, max(lifted_m, -clearance_m), lifted_m)
        sites.append(site)
    if velocity_limits_rad_s is None:
        return sites
    tip_speeds_m_s = {"speeds_m_s": max(plan.speeds_m_s), "travel_speed_m_s": plan.travel_speed_m_s}
    name, speed_m_s = max(tip_speeds_m_s.items(), key=lambda item: item[1])
    for number, site in enumerate(sites, 1):
        near_rad = position_rad
        for travel_m in np.linspace(0.0, site.deepest_travel_m, _STEPS):
            motion = site.line.joint_motion(LineState(float(travel_m), speed_m_s), near_rad)
            near_rad = motion.position_rad
            share = np.abs(motion.velocity_rad_s) * _SPEED_MARGIN / velocity_limits_rad_s
            joint = int(share.argmax())
            if share[joint] > 1.0:
                raise InputError(
                    f"{name} {speed_m_s:g} m/s: at target {number} joint {joint + 1} would move at "
                    f"{abs(motion.velocity_rad_s[joint]):.3g} rad/s, but the guard trips at "
                    f"{velocity_limits_rad_s[joint]:g} rad/s (limits.velocity_rad_s); "
                    f"use at most {speed_m_s / share[joint]:.2g} m/s"
                )
    return sites


def check_against_guard(plan: ProbingPlan, robot_file: RobotFile) -> None:
    """Check that forces and joint speeds of a plan stay below the limits of the robot's guard.

    Args:
        plan: the plan; its largest forces and joint speeds are checked.
        robot_file: robot file with the limits; each limit keeps a margin.

    Raises:
        InputError: the guard would trip; the error names the largest valid value.
    """
    limits = robot_file.limits
    max_force_n = limits.force_n / _FORCE_MARGIN  # applies to an excitation too, which only reduces the force
    if plan.force_limit_n > max_force_n:
        raise InputError(
            f"force_limit_n {plan.force_limit_n:g} N: the guard of '{robot_file.name}' trips at "
            f"{limits.force_n:g} N (limits.force_n); use at most {max_force_n:.3g} N"
        )
    trips_rad_s = min(limits.velocity_rad_s)
    max_speed_rad_s = trips_rad_s / _SPEED_MARGIN
    speeds_rad_s = {"joint_speed_rad_s": plan.joint_speed_rad_s}
    if plan.free_air_swing_m:
        speeds_rad_s["free_air_swing_speeds_rad_s"] = max(plan.free_air_swing_speeds_rad_s)
    for name, speed_rad_s in speeds_rad_s.items():
        if speed_rad_s > max_speed_rad_s:
            raise InputError(
                f"{name} {speed_rad_s:g}: the guard of '{robot_file.name}' trips at "
                f"{trips_rad_s:g} rad/s (limits.velocity_rad_s); use at most {max_speed_rad_s:.3g} rad/s"
            )
