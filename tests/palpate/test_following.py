"""An arm that follows another program's goals: motion limits, guard, and end."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from palpate.robot_io.errors import InputError, LifecycleError, SafetyTripError
from palpate.robot_io.session import Session
from palpate.runs.following import FollowingArm, FollowingJob, GoalReference
from palpate.runs.robots import find_robot, shipped_robots

TICK_S = 1e-3
SPEED = np.array([1.0, 2.0])


def moved(goals, ticks_each):
    """Positions, velocities and accelerations of a reference that is given goals, each for some ticks."""
    reference, motions = GoalReference(np.zeros(2), SPEED, 5.0), []
    for goal in goals:
        reference.aim(np.array(goal))
        motions += [reference.step(TICK_S) for _ in range(ticks_each)]
    return reference, [np.array(part) for part in zip(*motions, strict=True)]


def test_goals_are_reached_within_limits_without_overshoot_or_steps():
    reference, (position, velocity, acceleration) = moved([(2.0, -2.0)], 4000)
    assert reference.arrived
    assert position[-1] == pytest.approx([2.0, -2.0], abs=1e-3)
    assert np.all(np.abs(velocity).max(axis=0) <= SPEED * 1.02)
    assert np.abs(velocity[:, 1]).max() > 1.9
    assert np.abs(acceleration).max() <= 5.0
    assert np.abs(position).max() < 2.01
    times = np.arange(0.0, 3.0, 0.02)
    _, (_, _, acceleration) = moved([(0.3 * np.sin(2 * t), 0.0) for t in times], 20)
    settled = acceleration[500:, 0]
    assert np.abs(settled).max() < 1.6 * 0.3 * 2**2  # with steps it would be at its limit, 5


def job(folder, robot="follower", **changed):
    return FollowingJob(find_robot(str(robot)), folder / "arm.mcap", seed=1, **changed)


def arm_near(goal, arm):
    """Measures until the arm is at the goal; simulated time passes meanwhile."""
    for _ in range(20_000):
        measurement = arm.follow(goal)
        if np.abs(measurement.joint_position_rad - goal).max() < 2e-3:
            return measurement
    raise AssertionError(f"never at {goal}: {measurement}")


def test_arm_follows_goals_up_to_its_limits_and_returns(tmp_path):
    arm = FollowingArm(job(tmp_path, speed_share=0.9))
    with pytest.raises(LifecycleError, match="not running"):
        arm.measure()
    home = arm.start().joint_position_rad
    with pytest.raises(LifecycleError, match="already running"):
        arm.start()
    beyond, limits = home + 0.1, find_robot("follower").limits
    beyond[2] = limits.position_max_rad[2] + 1.0
    goal = beyond.clip(arm.low_rad, arm.high_rad)
    assert goal[2] < limits.position_max_rad[2]  # a goal ends before the guard's limit
    arm_near(goal, arm)
    with pytest.raises(InputError, match="not finite"):
        arm.follow(np.array([0.0, np.nan, 0.0]))
    assert arm.measure().joint_torque_nm[0] > 1.0
    arm.stop()
    arm.stop()
    samples = Session.open(tmp_path / "arm.mcap").samples("tick")
    assert np.abs(samples["joint_position_rad"][-1] - home).max() < 2e-3
    assert np.abs(samples["joint_position_rad"] - home).max() > 0.09
    assert not samples["guard_tripped"].any()


def test_guard_stop_is_raised_and_persists(tmp_path):
    folder = tmp_path / "arm"
    shutil.copytree(shipped_robots()["follower"].parent, folder)
    weak = (folder / "follower.yaml").read_text().replace("force_n: 60.0", "force_n: 3.0")
    (folder / "weak.yaml").write_text(weak)
    arm = FollowingArm(job(tmp_path, folder / "weak.yaml", acceleration_rad_s2=3.0))
    home = arm.start().joint_position_rad
    with pytest.raises(SafetyTripError, match="force"):
        arm_near(home - np.array([0.6, 0.0, 0.0]), arm)
    with pytest.raises(SafetyTripError, match="force"):
        arm.measure()
    assert arm.running
    arm.stop()
    assert not arm.running
    assert Session.open(tmp_path / "arm.mcap").samples("tick")["guard_tripped"][-1]


def test_dead_program_returns_the_arm_and_an_invalid_job_is_refused(tmp_path):
    arm = FollowingArm(job(tmp_path))
    home = arm.start().joint_position_rad
    arm_near(home + 0.05, arm)
    arm._line.close()
    assert arm._process.wait(60.0) == 0
    samples = Session.open(tmp_path / "arm.mcap").samples("tick")
    assert np.abs(samples["joint_position_rad"][-1] - home).max() < 2e-3
    (tmp_path / "arm.mcap").write_bytes(b"somebody else's")
    arm = FollowingArm(job(tmp_path))
    with pytest.raises(InputError, match=r"arm\.mcap"):
        arm.start()
    assert not arm.running
    with pytest.raises(InputError, match="speed_share 2"):
        replace(job(tmp_path), speed_share=2.0)
