"""What every reading of every device must keep, whatever it measures."""

import numpy as np

from palpate.robot_io.types import Status


def check_before_first_sample(bench, read, count):
    """Configured, unknown is NaN, old and stale; a device that has sampled already is as good as any."""
    reading = read(bench.robot)
    assert reading.value.shape == (count,)
    if np.isfinite(reading.sampled_at_s):
        assert np.isfinite(reading.value).all()
    else:
        assert reading.sampled_at_s == -np.inf
        assert np.isnan(reading.value).all()
        assert reading.status is Status.STALE


def check_samples(bench, read, count, oldest_s):
    """Fresh, finite, of the right shape, with the device's own time, in the past of the robot's clock."""
    times = []
    for _ in range(40):
        bench.tick()
        reading = read(bench.robot)
        assert reading.value.shape == (count,)
        assert reading.value.dtype == np.float64
        assert np.isfinite(reading.value).all()
        assert reading.status in (Status.OK, Status.STALE)
        assert 0 <= bench.clock.now_s() - reading.sampled_at_s <= oldest_s + 2 * bench.period_s
        times.append(reading.sampled_at_s)
    assert (np.diff(times) >= 0).all()
    assert times[-1] > times[0]


def check_reading_is_a_snapshot(bench, read):
    """Reading takes no time and changes nothing, and what was read does not change later."""
    bench.tick()
    before_s = bench.clock.now_s()
    first, again = read(bench.robot), read(bench.robot)
    assert first.sampled_at_s == again.sampled_at_s
    np.testing.assert_array_equal(first.value, again.value)
    assert bench.clock.now_s() - before_s < bench.period_s
    kept, kept_at_s = first.value.copy(), first.sampled_at_s
    for _ in range(20):
        bench.tick(np.full(bench.robot.joint_count, 0.1))
    np.testing.assert_array_equal(first.value, kept)
    assert first.sampled_at_s == kept_at_s
