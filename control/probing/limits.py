"""Holds a probing plan against the guard that it is to run under, before anything moves."""

from collections.abc import Iterable

import numpy as np

from control.paths.motion import LineState
from control.probing.plan import ProbingPlan
from control.probing.sites import ProbingSite
from robot_io.errors import InputError
from robot_io.robot_file import RobotFile
from robot_io.types import FloatArray

_FORCE_MARGIN = 1.1  # what touch and loading overshoot by, and a little more
_SPEED_MARGIN = 1.1  # what an encoder's noise and the controller's corrections add
_STEPS = 20  # places on a press line that are looked at


def check_against_guard(plan: ProbingPlan, robot_file: RobotFile) -> None:
    """Force and joint speed.

    Raises:
        InputError: the guard would trip on what the plan asks for.
    """
    limits = robot_file.limits
    most_n = limits.force_n / _FORCE_MARGIN  # also with an excitation, which only takes force away
    if plan.force_limit_n > most_n:
        raise InputError(
            f"force_limit_n {plan.force_limit_n:g} N: the guard of '{robot_file.name}' trips at "
            f"{limits.force_n:g} N (limits.force_n); at most {most_n:.3g} N"
        )
    trips_rad_s = min(limits.velocity_rad_s)
    most_rad_s = trips_rad_s / _SPEED_MARGIN
    speeds_rad_s = {"joint_speed_rad_s": plan.joint_speed_rad_s}
    if plan.free_air_swing_m:
        speeds_rad_s["free_air_swing_speeds_rad_s"] = max(plan.free_air_swing_speeds_rad_s)
    for name, speed_rad_s in speeds_rad_s.items():
        if speed_rad_s > most_rad_s:
            raise InputError(
                f"{name} {speed_rad_s:g}: the guard of '{robot_file.name}' trips at "
                f"{trips_rad_s:g} rad/s (limits.velocity_rad_s); at most {most_rad_s:.3g} rad/s"
            )


def check_tip_speeds(
    sites: Iterable[ProbingSite], plan: ProbingPlan, near_rad: FloatArray, velocity_limits_rad_s: FloatArray
) -> None:
    """Speeds of the tip, which joints must follow on each press line.

    Args:
        sites: where the plan presses.
        plan: its speeds.
        near_rad: present joint positions, shape (n,) [rad].
        velocity_limits_rad_s: at which the guard trips, shape (n,) [rad/s].

    Raises:
        InputError: a joint would move too fast.
    """
    name, speed_m_s = max(
        ("speeds_m_s", max(plan.speeds_m_s)),
        ("travel_speed_m_s", plan.travel_speed_m_s),
        key=lambda item: item[1],
    )
    for number, site in enumerate(sites, 1):
        here_rad = near_rad
        for travel_m in np.linspace(0.0, site.deepest_travel_m, _STEPS):
            motion = site.line.joint_motion(LineState(float(travel_m), speed_m_s), here_rad)
            here_rad = motion.position_rad
            share = np.abs(motion.velocity_rad_s) * _SPEED_MARGIN / velocity_limits_rad_s
            joint = int(share.argmax())
            if share[joint] > 1.0:
                raise InputError(
                    f"{name} {speed_m_s:g} m/s: at target {number} joint {joint + 1} would move at "
                    f"{abs(motion.velocity_rad_s[joint]):.3g} rad/s, the guard trips at "
                    f"{velocity_limits_rad_s[joint]:g} rad/s (limits.velocity_rad_s); "
                    f"at most {speed_m_s / share[joint]:.2g} m/s"
                )
