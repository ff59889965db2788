"""The press line: joint motion against finite differences and forward kinematics."""

import numpy as np
import pytest

from control.arm.inverse_kinematics import Elbow, PlanarArm
from control.paths.press_line import PressLine
from control.paths.trajectory import LineState
from robot_io.errors import InputError
from tests.control.reference_plant import DOWN, TOOL_AXIS_TIP, test_arm

START = np.array([0.42, 0.0, 0.10])
SLANTED = np.array([0.6, 0.0, -0.8])
NOWHERE = (np.full(3, -9.0), np.full(3, 9.0))


def line(start=START, direction=DOWN, elbow=Elbow.POSITIVE) -> PressLine:
    return PressLine(PlanarArm(test_arm(), TOOL_AXIS_TIP), start, direction, elbow)


@pytest.mark.parametrize("direction", [DOWN, SLANTED])
@pytest.mark.parametrize("elbow", list(Elbow))
def test_the_tip_follows_the_line_and_keeps_the_tool_direction(direction, elbow):
    body, press = test_arm(), line(direction=direction, elbow=elbow)
    near = press.start.position_rad
    for travel_m in (0.0, 0.02, 0.05):
        motion = press.joint_motion(LineState(travel_m, 0.15, 2.0), near)
        tip = body.tip_motion(motion.position_rad, motion.velocity_rad_s)
        assert tip.position_world_m == pytest.approx(START + travel_m * direction, abs=1e-9)
        assert tip.velocity_world_m_s == pytest.approx(0.15 * direction, abs=1e-9)
        assert tip.rotation_world_tip @ TOOL_AXIS_TIP == pytest.approx(direction, abs=1e-9)
        assert tip.jacobian_world[3:] @ motion.velocity_rad_s == pytest.approx(np.zeros(3), abs=1e-9)
        assert press.travel_of(tip.position_world_m) == pytest.approx(travel_m, abs=1e-12)


def test_joint_velocity_and_acceleration_match_finite_differences():
    press, step_s = line(direction=SLANTED), 1e-4
    near = press.start.position_rad

    def at(time_s: float):
        speed, acceleration = 0.1 + 1.5 * time_s, 1.5
        return press.joint_motion(
            LineState(0.02 + 0.1 * time_s + 0.75 * time_s**2, speed, acceleration), near
        )

    behind, now, ahead = at(-step_s), at(0.0), at(step_s)
    velocity = (ahead.position_rad - behind.position_rad) / (2 * step_s)
    acceleration = (ahead.velocity_rad_s - behind.velocity_rad_s) / (2 * step_s)
    assert now.velocity_rad_s == pytest.approx(velocity, abs=1e-6)
    assert now.acceleration_rad_s2 == pytest.approx(acceleration, abs=1e-5)


def test_positions_stay_on_the_turn_they_were_on():
    press = line()
    near = press.start.position_rad + np.array([2 * np.pi, -2 * np.pi, 0.0])
    assert press.joint_motion(LineState(0.0), near).position_rad == pytest.approx(near)


def test_reach_ends_at_the_arm_and_at_the_joint_limits():
    press = line()
    near = press.start.position_rad
    assert press.reach_m(0.05, near, NOWHERE) == pytest.approx(0.05)
    far_m = press.reach_m(2.0, near, NOWHERE)
    assert 0.1 < far_m < 1.0
    press.joint_motion(LineState(far_m), near)  # reachable
    with pytest.raises(InputError, match=r"reach|singular"):
        press.joint_motion(LineState(far_m + 0.02), near)
    assert press.reach_m(-2.0, near, NOWHERE) < -0.1
    tight = (near - 0.05, near + 0.05)
    limited_m = press.reach_m(2.0, near, tight)
    assert 0.0 < limited_m < far_m
    moved = press.joint_motion(LineState(limited_m), near).position_rad
    assert (np.abs(moved - near) <= 0.05).all()


def test_a_start_out_of_reach_is_refused():
    with pytest.raises(InputError, match="out of reach"):
        line(start=np.array([0.9, 0.0, 0.1]))
