"""Contract of every device reading."""

import numpy as np

from palpate.robot_io.types import Status


def take(robot):
    """Each reading of a robot by its name."""
    return {
        "position": robot.encoder.read_position(),
        "velocity": robot.encoder.read_velocity(),
        "torque": robot.torque.read_torque(),
        "force": robot.force.read_force(),
    }


def shape_of(robot_setup, name):
    return (1,) if name == "force" else (robot_setup.robot_file.joint_count,)


def test_before_the_first_sample_only_joints_are_known(robot_setup):
    """Configured, unknown is NaN, old and stale; a device that has sampled already is as good as any."""
    assert (
        robot_setup.robot.encoder.joint_count
        == robot_setup.robot.torque.joint_count
        == robot_setup.robot_file.joint_count
    )
    robot_setup.robot.configure()
    for name, reading in take(robot_setup.robot).items():
        assert reading.value.shape == shape_of(robot_setup, name)
        if np.isfinite(reading.sampled_at_s):
            assert np.isfinite(reading.value).all()
        else:
            assert reading.sampled_at_s == -np.inf
            assert np.isnan(reading.value).all()
            assert reading.status is Status.STALE


def test_samples_are_fresh_and_a_reading_is_a_snapshot(active):
    """Fresh, finite, of the right shape, with the device's own time, in the past of the robot's clock."""
    limits = active.robot_file.limits
    oldest_s = dict.fromkeys(("position", "velocity"), limits.encoder_age_s)
    oldest_s |= {"torque": limits.torque_age_s, "force": limits.force_age_s}
    times = {name: [] for name in oldest_s}
    for _ in range(40):
        active.tick()
        for name, reading in take(active.robot).items():
            assert reading.value.shape == shape_of(active, name)
            assert reading.value.dtype == np.float64
            assert np.isfinite(reading.value).all()
            assert reading.status in (Status.OK, Status.STALE)
            age_s = active.clock.now_s() - reading.sampled_at_s
            assert 0 <= age_s <= oldest_s[name] + 2 * active.period_s, name
            times[name].append(reading.sampled_at_s)
    for name, sampled_at_s in times.items():
        assert (np.diff(sampled_at_s) >= 0).all(), name
        assert sampled_at_s[-1] > sampled_at_s[0], name
    # Reading takes no time and changes nothing, and what was read does not change later.
    active.tick()
    before_s = active.clock.now_s()
    first, again = take(active.robot), take(active.robot)
    assert active.clock.now_s() - before_s < active.period_s
    for name, reading in first.items():
        assert reading.sampled_at_s == again[name].sampled_at_s
        np.testing.assert_array_equal(reading.value, again[name].value)
    kept = {name: (reading.value.copy(), reading.sampled_at_s) for name, reading in first.items()}
    for _ in range(20):
        active.tick(np.full(active.robot.joint_count, 0.1))
    for name, (value, sampled_at_s) in kept.items():
        np.testing.assert_array_equal(first[name].value, value)
        assert first[name].sampled_at_s == sampled_at_s
