"""Where a probing plan presses: one line per target, checked against the arm before anything moves."""

from control.arm.inverse_kinematics import Elbow, PlanarArm
from control.paths.motion import LineState
from control.paths.press_line import PressLine
from control.paths.trajectory import blend_distance_m
from control.probing.plan import ProbingPlan
from robot_io.errors import InputError
from robot_io.types import FloatArray, frozen_array

JointLimits = tuple[FloatArray, FloatArray]
_LIFT_ROOM_M = 0.1  # above the highest target's clearance, for the way to the next one, at least


class ProbingSite:
    """A target: its press line and how far the tip may go on it.

    Args:
        line: the press line; an approach starts at travel 0 until the surface is known.
        search_travel_m: the surface must be touched before this travel [m].
        deepest_travel_m: the tip never goes beyond this travel [m].
        highest_travel_m: nor does an approach start before this one, which is not positive [m].
        lifted_travel_m: nor does the tip go back beyond this one, which is not above that one [m].
    """

    def __init__(
        self,
        line: PressLine,
        search_travel_m: float,
        deepest_travel_m: float,
        highest_travel_m: float,
        lifted_travel_m: float,
    ) -> None:
        self.line = line
        self.search_travel_m = search_travel_m
        self.deepest_travel_m = deepest_travel_m
        self.approach_travel_m = 0.0
        self._highest_travel_m = highest_travel_m
        self._lifted_travel_m = lifted_travel_m

    def start_above(self, surface_travel_m: float, clearance_m: float) -> None:
        """Let the next approach start a clearance [m] before the surface found at a travel [m]."""
        self.approach_travel_m = max(surface_travel_m - clearance_m, self._highest_travel_m)

    @property
    def lift_room_m(self) -> float:
        """How far the tip can be lifted from where the next approach starts [m]."""
        return self.approach_travel_m - self._lifted_travel_m

    def joint_position_rad(self, near_rad: FloatArray) -> FloatArray:
        """Joint positions (3,) [rad] at the start of the approach, turns nearest to `near_rad`."""
        return self.line.joint_motion(LineState(self.approach_travel_m), near_rad).position_rad

    def lifted_rad(self, lift_m: float, near_rad: FloatArray) -> FloatArray:
        """Joint positions (3,) [rad] with the tip lifted by `lift_m` [m], or as high as can be."""
        travel_m = max(self.approach_travel_m - lift_m, self._lifted_travel_m)
        return self.line.joint_motion(LineState(travel_m), near_rad).position_rad


def probing_sites(
    arm: PlanarArm,
    plan: ProbingPlan,
    tip_position_world_m: FloatArray,
    position_rad: FloatArray,
    limits_rad: JointLimits,
) -> list[ProbingSite]:
    """The sites of a plan, with the elbow bent as it is now.

    Args:
        arm: closed-form kinematics.
        plan: targets, direction and depths.
        tip_position_world_m: shape (3,), where the only approach starts if the plan has no targets [m].
        position_rad: present joint positions, shape (3,) [rad].
        limits_rad: lowest and highest joint positions, (3,) each [rad].

    Raises:
        InputError: an approach cannot be started, or there is no room behind its start to search.
    """
    direction = frozen_array(plan.press_direction_world)
    starts = [frozen_array(target) - plan.approach_clearance_m * direction for target in plan.targets_world_m]
    elbow = arm.elbow_of(position_rad)
    places = starts or [tip_position_world_m]
    highest_m = min(float(start @ direction) for start in places)
    sites = []
    for number, start in enumerate(places, 1):
        name = f"target {number} ({_millimetres(start)})" if starts else "below the tip"
        line = _line(arm, start, direction, elbow, name)
        room_m = max(_LIFT_ROOM_M, plan.free_air_swing_m)
        lift_m = float(start @ direction) - highest_m + room_m
        sites.append(_site(line, plan, position_rad, limits_rad, lift_m, name))
    return sites


def _line(arm: PlanarArm, start: FloatArray, direction: FloatArray, elbow: Elbow, name: str) -> PressLine:
    try:
        line = PressLine(arm, start, direction, elbow)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    if line.start.near_singular:
        raise InputError(f"{name}: the arm would be stretched or folded (singular); move the target")
    return line


def _site(  # noqa: PLR0917 (all that bounds it)
    line: PressLine,
    plan: ProbingPlan,
    near_rad: FloatArray,
    limits_rad: JointLimits,
    lift_m: float,
    name: str,
) -> ProbingSite:
    deepest_m = line.reach_m(plan.search_depth_m + plan.max_depth_m, near_rad, limits_rad)
    clearance_m = max(plan.retract_m, plan.approach_clearance_m)
    lifted_m = line.reach_m(-clearance_m - lift_m, near_rad, limits_rad)
    search_m = min(plan.search_depth_m, deepest_m)
    run_up_m = blend_distance_m(max(plan.speeds_m_s), plan.acceleration_m_s2)
    if plan.search_depth_m <= run_up_m:
        raise InputError(
            f"search_depth_m {plan.search_depth_m:g} m: the tip needs more than {run_up_m:.4f} m to come up "
            "to speed"
        )
    if search_m <= run_up_m:
        raise InputError(
            f"{name}: the arm can go only {deepest_m * 1e3:.0f} mm on from the start of the approach within "
            f"its joint limits, and needs more than {run_up_m * 1e3:.1f} mm to come up to speed"
        )
    return ProbingSite(line, search_m, deepest_m, max(lifted_m, -clearance_m), lifted_m)


def _millimetres(position_m: FloatArray) -> str:
    return ", ".join(f"{1e3 * value:.0f}" for value in position_m) + " mm"
