"""What every bus keeps."""

from contextlib import suppress

import numpy as np

from robot_io.errors import DeviceTimeoutError


def sample_times(robot):
    readings = (
        robot.encoder.read_position(),
        robot.encoder.read_velocity(),
        robot.torque.read_torque(),
        robot.force.read_force(),
    )
    return np.array([reading.sampled_at_s for reading in readings])


def test_polling_brings_new_samples(active):
    before = sample_times(active.robot)
    for _ in range(20):
        active.clock.sleep_until(active.clock.now_s() + active.period_s)
        for bus in active.robot.buses.values():
            bus.poll(active.clock.now_s() + active.period_s)
    assert (sample_times(active.robot) > before).all()


def test_without_polling_samples_stay_as_they_are(active):
    before = sample_times(active.robot)
    active.clock.sleep_until(active.clock.now_s() + 10 * active.period_s)
    np.testing.assert_array_equal(sample_times(active.robot), before)


def test_a_deadline_that_has_passed_is_not_waited_for(active):
    for bus in active.robot.buses.values():
        before_s = active.clock.now_s()
        with suppress(DeviceTimeoutError):  # nothing had arrived: an honest answer
            bus.poll(before_s - 1.0)
        assert active.clock.now_s() - before_s < 5 * active.period_s
    assert (sample_times(active.robot) <= active.clock.now_s()).all()


def test_polling_twice_and_flushing_with_nothing_staged_are_harmless(active):
    for _ in range(3):
        for bus in active.robot.buses.values():
            bus.poll(active.clock.now_s() + active.period_s)
    assert (sample_times(active.robot) <= active.clock.now_s()).all()
    active.tick()
    for bus in active.robot.buses.values():
        bus.flush(active.clock.now_s() + active.period_s)
        bus.flush(active.clock.now_s() + active.period_s)
    assert np.isfinite(active.tick().joint_position_rad).all()
