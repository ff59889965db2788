"""Contract of every robot."""

import numpy as np
import pytest

from palpate.robot_io.errors import InputError, LifecycleError
from palpate.robot_io.robot import RobotState
from palpate.robot_io.types import Command, Status


def test_robot_starts_at_home_with_coherent_immutable_measurements(active):
    np.testing.assert_allclose(active.tick().joint_position_rad, active.robot_file.home_rad, atol=0.1)
    last_s = -np.inf
    for _ in range(30):
        m = active.tick()
        assert m.time_s > last_s
        last_s = m.time_s
        for array in (m.joint_position_rad, m.joint_velocity_rad_s, m.joint_torque_nm):
            assert array.shape == (active.robot_file.joint_count,)
            assert np.isfinite(array).all()
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0.0
        assert np.isfinite(m.force_n)
        assert max(m.encoder_status, m.torque_status, m.force_status) <= Status.STALE


def test_write_returns_what_was_sent_and_sends_nothing_nonfinite(active):
    wanted = 0.1 * np.array(active.robot_file.limits.torque_nm)
    sent = active.robot.write(Command(wanted), active.clock.now_s() + active.period_s)
    np.testing.assert_allclose(sent.joint_torque_nm, wanted, rtol=0.1, atol=0.02)
    assert sent.joint_torque_nm is not wanted
    assert not sent.joint_torque_nm.flags.writeable
    torque = np.zeros(active.robot.joint_count)
    for torque[0] in (np.nan, np.inf):
        with pytest.raises(InputError, match="not finite"):
            active.robot.write(Command(torque), active.clock.now_s())


def test_lifecycle_calls_follow_their_order(robot_setup):
    robot = robot_setup.robot
    with pytest.raises(LifecycleError):
        robot.read(robot_setup.clock.now_s())
    with pytest.raises(LifecycleError):
        robot.activate()
    robot.configure()
    assert np.isfinite(robot_setup.settle().joint_position_rad).all()  # read before it is powered
    with pytest.raises(LifecycleError, match="configured"):
        robot.write(Command(np.zeros(robot.joint_count)), robot_setup.clock.now_s())
    for _ in range(2):
        robot.activate()
        robot_setup.tick()
        robot.deactivate()
        robot.deactivate()
    robot.activate()
    robot.close()
    robot.close()
    robot.deactivate()
    assert robot.state is RobotState.CLOSED
    for call in (robot.configure, robot.activate, lambda: robot.read(robot_setup.clock.now_s())):
        with pytest.raises(LifecycleError, match="closed"):
            call()


def test_with_block_closes_the_robot(robot_setup):
    def fail_inside():
        with robot_setup.robot as robot:
            robot.activate()
            robot_setup.tick()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_inside()
    assert robot_setup.robot.state is RobotState.CLOSED


def test_two_robots_do_not_disturb_each_other(open_setup):
    setups = [open_setup(), open_setup()]
    for robot_setup in setups:
        robot_setup.robot.configure()
        robot_setup.robot.activate()
        robot_setup.settle()
    push = 0.05 * np.array(setups[0].robot_file.limits.torque_nm)
    alone = open_setup()
    alone.robot.configure()
    alone.robot.activate()
    alone.settle()
    for _ in range(15):
        setups[0].tick(push)
        with_a_neighbor = setups[1].tick()
        by_itself = alone.tick()
    np.testing.assert_allclose(with_a_neighbor.joint_position_rad, by_itself.joint_position_rad, atol=1e-3)
