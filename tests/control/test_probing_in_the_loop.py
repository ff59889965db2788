"""Probing task in the real loop, on the mock robot and on both simulated arms."""

from contextlib import closing

import numpy as np
import pytest

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import gains_of
from palpate.control.loop.loop import run_loop
from palpate.control.loop.task import Phase
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from tests import mock_robot
from tests.control.loop_parts import RATE_HZ, MemoryLog, MockArm
from tests.control.simulated_arms import SimulatedArm, kelvin_voigt


def test_mock_robot_is_probed_through_the_interfaces_alone():
    arm, log = MockArm(), MemoryLog()
    robot_file = mock_robot.mock_robot_file()
    body = RigidBody.from_urdf(mock_robot.URDF, robot_file.tip_frame)
    limits = (np.array(robot_file.limits.position_min_rad), np.array(robot_file.limits.position_max_rad))
    plan = ProbingPlan(speeds_m_s=(0.09, 0.05), hold_s=0.4)
    task = ProbingTask(
        body, np.array(robot_file.sensor_axis_tip), gains_of(robot_file), plan, position_limits_rad=limits
    )
    result = run_loop(arm.robot, arm.guard, task, arm.clock, log, rate_hz=RATE_HZ)
    arm.robot.close()
    result.raise_for_trip()
    assert task.failures == ()
    assert [kind for _, kind, _ in log.events].count("limit_reached") == 2


@pytest.mark.parametrize(
    ("name", "stiffness", "damping", "speed_m_s"),
    [
        *[
            ("follower", 100.0, 0.0, 0.15),
            ("leader", 7100.0, 100.0, 0.05),
            ("follower", 10_000.0, 200.0, 0.05),
        ],
        *[("follower", 100.0, 200.0, 0.15), ("leader", 2000.0, 200.0, 0.15)],
    ],
)
def test_simulated_arms_keep_the_force_limit_and_return_home_to_rest(name, stiffness, damping, speed_m_s):
    plan = ProbingPlan(speeds_m_s=(speed_m_s,), hold_s=0.5)
    arm = SimulatedArm(name, plan, kelvin_voigt(stiffness, damping))
    with closing(arm.robot):
        arm.run().raise_for_trip()
        ended = arm.world.truth()
        arm.wait(0.5)  # the torque is off
        later = arm.world.truth()
    assert arm.task.failures == ()
    log, (time_s, _, force_n, _) = arm.log, arm.truth.T
    assert force_n[time_s >= time_s[force_n > 0.0][0] + 0.020].max() <= 10.5
    pressed_s = log.column("time_s")[np.isin(log.column("phase"), (Phase.LOADING, Phase.HOLD))]
    assert force_n[(time_s > pressed_s[0]) & (time_s < pressed_s[-1])].min() > 0.0  # contact is never lost
    held_s = log.column("time_s")[log.column("phase") == Phase.HOLD][-200:]
    held = (time_s > held_s[0]) & (time_s < held_s[-1])
    assert force_n[held] == pytest.approx(10.0, abs=0.2)
    tracking = np.abs(log.column("joint_position_rad") - log.column("reference_position_rad"))
    assert tracking.max() < 0.003
    assert ended.joint_position_rad == pytest.approx(arm.robot_file.home_rad, abs=1e-3)
    assert np.abs(ended.joint_velocity_rad_s).max() < 0.01
    assert later.force_n == 0.0
    assert later.tip_position_world_m == pytest.approx(ended.tip_position_world_m, abs=1e-3)
