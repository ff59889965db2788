"""What every force sensor keeps."""

import pytest

from tests.contract import readings


def read_force(robot):
    return robot.force.read_force()


def test_unknown_before_the_first_sample(bench):
    bench.robot.configure()
    readings.check_before_first_sample(bench, read_force, 1)


def test_samples_are_fresh_and_honest(active):
    readings.check_samples(active, read_force, 1, active.robot_file.limits.force_age_s)


def test_a_reading_is_a_snapshot(active):
    readings.check_reading_is_a_snapshot(active, read_force)


def test_free_air_is_about_zero(active):
    assert abs(active.tick().force_n) < 1.0


def test_compression_is_positive(active):
    if active.press is None:
        pytest.skip("nobody can press this sensor")
    active.press(5.0)
    pressed_n = [active.tick().force_n for _ in range(10)][-1]
    active.press(0.0)
    released_n = [active.tick().force_n for _ in range(10)][-1]
    assert pressed_n == pytest.approx(5.0, abs=0.3)
    assert released_n == pytest.approx(0.0, abs=0.3)
