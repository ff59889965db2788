"""The probing task in the real loop, on the mock robot (interfaces only) and on both simulated arms."""

from pathlib import Path

import numpy as np
import pytest

from control.arm.rigid_body import RigidBody
from control.laws.gains import gains_of
from control.loop.loop import run_loop
from control.loop.phases import Phase
from control.probing.plan import ProbingPlan
from control.probing.task import ProbingTask
from robot_io.clock import SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.guard import Guard
from robot_io.robot import build_robot
from robot_io.robot_file import load_robot_file
from tests import mock_robot
from tests.control.loop_parts import RATE_HZ, Arm, MemoryLog

ARMS = Path(__file__).resolve().parents[2] / "sim_backend" / "arms"


def test_the_mock_robot_is_probed_through_the_interfaces_alone():
    arm, log = Arm(), MemoryLog()
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


@pytest.mark.parametrize("name", ["follower", "leader"])
@pytest.mark.parametrize(
    ("stiffness", "damping", "speed_m_s"),
    [(100.0, 0.0, 0.15), (500.0, 100.0, 0.15), (7100.0, 100.0, 0.05), (10_000.0, 200.0, 0.05)],
)
def test_the_simulated_arms_keep_the_force_limit(name, stiffness, damping, speed_m_s):
    robot_file = load_robot_file(ARMS / name / f"{name}.yaml")
    clock, log, truth = SimulatedClock(), MemoryLog(), []
    robot = build_robot(robot_file, DriverCatalogue("robot_io.drivers", "sim_backend.drivers"), clock)
    guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count)
    task = ProbingTask.from_robot_file(robot_file, ProbingPlan(speeds_m_s=(speed_m_s,), hold_s=0.5))
    bus = robot.buses["world"]
    law = {"name": "kelvin_voigt", "stiffness_n_m": stiffness, "damping_n_s_m": damping}
    bus.use_scenario(bus.scenario.model_validate({"object": {"law": law}}))

    def watch(measurement, output):
        truth.append(bus.world.truth().force_n)
        return np.nan, np.nan, np.nan

    with robot:
        result = run_loop(robot, guard, task, clock, log, rate_hz=1000.0, observer=watch)
    result.raise_for_trip()
    assert task.failures == ()
    force, time_s, phase = np.array(truth), log.column("time_s"), log.column("phase")
    touched_s = time_s[force > 0.0][0]
    assert force[time_s >= touched_s + 0.020].max() <= 10.5
    assert force[phase == Phase.HOLD][-200:] == pytest.approx(10.0, abs=0.2)
    tracking = np.abs(log.column("joint_position_rad") - log.column("reference_position_rad"))
    assert tracking.max() < 0.003


@pytest.mark.parametrize("name", ["follower", "leader"])
def test_when_the_torque_goes_off_the_arm_stands_where_it_stood_before(name):
    robot_file = load_robot_file(ARMS / name / f"{name}.yaml")
    clock, log = SimulatedClock(), MemoryLog()
    robot = build_robot(robot_file, DriverCatalogue("sim_backend.drivers"), clock)
    guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count)
    task = ProbingTask.from_robot_file(robot_file, ProbingPlan(speeds_m_s=(0.15,), hold_s=0.2))
    with robot:
        world = robot.buses["world"].world
        run_loop(robot, guard, task, clock, log, rate_hz=1000.0).raise_for_trip()
        ended = world.truth()
        assert ended.joint_position_rad == pytest.approx(robot_file.home_rad, abs=1e-3)
        assert np.abs(ended.joint_velocity_rad_s).max() < 0.01
        clock.sleep_until(clock.now_s() + 0.5)
        assert world.truth().force_n == 0.0
        assert world.truth().tip_position_world_m == pytest.approx(ended.tip_position_world_m, abs=1e-3)
