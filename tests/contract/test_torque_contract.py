"""Contract of all torque-controlled drives."""

import numpy as np
import pytest

SMALL = 0.05  # of the torque limit


def small_torque(robot_setup):
    return SMALL * np.array(robot_setup.robot_file.limits.torque_nm)


def noise_nm(robot_setup):
    """What a torque sensor may show beside the torque [N m]."""
    return 0.05 * np.array(robot_setup.robot_file.limits.torque_nm)


def test_staging_returns_the_command_without_sending(active):
    wanted = small_torque(active)
    kept = wanted.copy()
    sent = active.robot.torque.stage_torque(wanted)
    assert sent.shape == wanted.shape
    np.testing.assert_allclose(sent, wanted, atol=noise_nm(active).max())
    sent *= 2.0
    active.tick()
    np.testing.assert_array_equal(wanted, kept)
    most = active.robot.torque.stage_torque(np.full(len(wanted), 1e9))  # out of range: reduced
    assert (most > 0).all()
    assert (most < 1e6).all()
    active.tick()
    active.robot.torque.stage_torque(np.array(active.robot_file.limits.torque_nm))
    for _ in range(5):
        measurement = active.read()
    assert (np.abs(measurement.joint_torque_nm) < noise_nm(active)).all()


def test_measured_torque_follows_the_command_until_commands_end(active):
    wanted = 0.3 * np.array(active.robot_file.limits.torque_nm)
    for _ in range(20):
        measurement = active.tick(wanted)
    np.testing.assert_allclose(measurement.joint_torque_nm, wanted, atol=noise_nm(active).max(), rtol=0.1)
    if active.watchdog_s is None:
        pytest.skip("these drives have no watchdog")
    active.tick(0.3 * np.array(active.robot_file.limits.torque_nm))
    for _ in range(int(1.5 * active.watchdog_s / active.period_s)):
        measurement = active.read()
    assert (np.abs(measurement.joint_torque_nm) < noise_nm(active)).all()


@pytest.mark.parametrize("joint", [0, 2])
def test_positive_torque_turns_the_joint_forwards(open_setup, joint):
    """Against the same motion with the torque reversed, so that gravity does not matter."""
    velocity = {}
    for sign in (-1.0, 1.0):
        robot_setup = open_setup()
        robot_setup.robot.configure()
        robot_setup.robot.activate()
        robot_setup.settle()
        torque = np.zeros(robot_setup.robot.joint_count)
        torque[joint] = sign * small_torque(robot_setup)[joint]
        for _ in range(20):
            measurement = robot_setup.tick(torque)
        velocity[sign] = measurement.joint_velocity_rad_s[joint]
    assert velocity[1.0] > velocity[-1.0]


def test_drives_forget_their_torque_when_deactivated(active):
    def drive():
        for _ in range(5):
            active.tick(0.3 * np.array(active.robot_file.limits.torque_nm))

    drive()
    active.robot.deactivate()
    active.robot.activate()
    if active.holds:
        here_rad = active.read().joint_position_rad
        for _ in range(100):
            measurement = active.read()
        np.testing.assert_allclose(measurement.joint_position_rad, here_rad, atol=0.1)
        assert (np.abs(measurement.joint_velocity_rad_s) < 0.1).all()
    else:
        for _ in range(5):
            measurement = active.read()
        assert (np.abs(measurement.joint_torque_nm) < noise_nm(active)).all()
    drive()
    active.robot.deactivate()
    for _ in range(20):
        measurement = active.read()
    assert (np.abs(measurement.joint_torque_nm) < noise_nm(active)).all()
