"""Sensors: sampling times, delays, noise and resolution of the scenario."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.types import Status
from palpate.sim_backend.sensors import ForceSettings, SimulatedForceSensor
from tests.sim_backend.parts import column, make_world, sample_each_step, scenario, shipped_arm, slider, watch

QUIET_FORCE = {"noise_std_n": 0.0, "resolution_n": 0.0}


def falling(**sensors):
    return make_world(slider(5.0), scenario(surface_m=-9.0, **sensors))


def resting(stiffness_depth_m=0.02, **sensors):
    """A held mass that presses 500 N/m in by 0.02 m: 10 N, still."""
    world = make_world(slider(-stiffness_depth_m), scenario(**sensors))
    world.held = True
    return world


@pytest.mark.parametrize("rate_hz", [1000.0, 333.0])
def test_samples_come_at_the_sensor_s_own_rate(rate_hz):
    world = resting(force={"rate_hz": rate_hz})
    times = np.array([sample.sampled_at_s for sample in sample_each_step(world, world.force_sensor, 1.0)])
    step_s = 1 / 4000.0
    late = times - np.arange(len(times)) / rate_hz
    assert len(times) >= rate_hz
    assert (late > -1e-9).all()
    assert (late < step_s).all()


def test_sampling_rate_above_the_physics_rate_samples_every_step():
    world = resting(force={"rate_hz": 50_000.0})
    assert len(sample_each_step(world, world.force_sensor, 0.1)) == 400


def test_late_sensor_shows_the_state_at_its_sample_time():
    delay_s = 0.004
    world = falling(encoder={"delay_s": delay_s, "counts_per_revolution": 1e9})
    fast = falling(encoder={"counts_per_revolution": 1e9})
    assert world.encoder.read(world.time_s) is None
    for tick in range(1, 60):
        world.advance_to(tick * 1e-3)
        sample = world.encoder.read(world.time_s)
        if tick < 4:
            assert sample is None
            continue
        assert world.time_s - sample.sampled_at_s == pytest.approx(delay_s)
        fast.advance_to(sample.sampled_at_s)
        assert sample.value[0] == pytest.approx(fast.truth().joint_position_rad[0], abs=1e-8)


@given(
    rate_hz=st.floats(50.0, 20_000.0),
    delay_s=st.floats(0.0, 0.02),
    step_s=st.sampled_from([1e-4, 2.5e-4, 1e-3]),
    reads=st.sets(st.integers(0, 299)),
)
def test_newest_arrived_sample_is_shown_for_any_rate_and_delay(rate_hz, delay_s, step_s, reads):
    """Against a sensor that never forgets: one without delay, read at each step."""
    late, prompt = (
        SimulatedForceSensor(
            ForceSettings(rate_hz=rate_hz, delay_s=seconds), np.random.default_rng(0), 0.0, step_s
        )
        for seconds in (delay_s, 0.0)
    )
    sampled_s = []
    for step in range(300):
        time_s = step * step_s
        for sensor in (late, prompt):
            sensor.observe(time_s, [float(step)])
        sampled_s.append(prompt.read(time_s).sampled_at_s)
        if step in reads:
            arrived_s = [at_s for at_s in sampled_s if at_s <= time_s - delay_s + 1e-9]
            sample = late.read(time_s)
            assert (sample and sample.sampled_at_s) == (max(arrived_s) if arrived_s else None)


def test_repeated_sample_is_stale_and_keeps_its_time():
    world = resting(force={"rate_hz": 500.0})
    statuses, times = [], []
    for tick in range(1, 7):
        world.advance_to(tick * 1e-3)
        sample = world.force_sensor.read(world.time_s)
        statuses.append(sample.status)
        times.append(sample.sampled_at_s)
    assert statuses == [Status.OK, Status.OK, Status.STALE, Status.OK, Status.STALE, Status.OK]
    assert times == pytest.approx([0.0, 0.002, 0.002, 0.004, 0.004, 0.006])


def test_torque_is_sampled_in_the_middle_of_its_command():
    world = make_world(shipped_arm("follower"), scenario(surface_m=-5.0, torque={"noise_std_nm": 0.0}))
    for tick in range(20):
        world.set_torque([0.5 * tick, 0.0, 0.0])
        world.advance_to((tick + 1) * 1e-3)
        sample = world.torque_sensor.read(world.time_s)
        assert sample.sampled_at_s == pytest.approx((tick + 0.5) * 1e-3)
        assert sample.value[0] == pytest.approx(0.5 * tick)


def test_force_noise_is_white_with_the_stated_spread_around_the_truth():
    world = resting(force={"noise_std_n": 0.05, "resolution_n": 0.0, "rate_hz": 4000.0})
    error = np.array([s.value[0] for s in sample_each_step(world, world.force_sensor, 2.0)]) - 10.0
    assert len(error) == 8000
    assert error.std() == pytest.approx(0.05, rel=0.04)
    assert abs(error.mean()) < 4 * 0.05 / np.sqrt(8000)
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.05


@pytest.mark.parametrize("resolution", [0.005, 0.1])
def test_force_has_steps_of_the_resolution(resolution):
    world = resting(force={"noise_std_n": 0.2, "resolution_n": resolution})
    values = np.array([s.value[0] for s in sample_each_step(world, world.force_sensor, 0.5)])
    steps = values / resolution
    assert np.allclose(steps, np.round(steps), atol=1e-6)
    assert len(set(np.round(steps))) > 5


def test_saturated_force_sensor_is_reported():
    world = resting(0.3, force={"range_n": 100.0})
    world.advance_to(0.001)
    sample = world.force_sensor.read(world.time_s)
    assert (sample.value, sample.status) == ([100.0], Status.SATURATED)


def test_band_limited_sensor_answers_a_step_with_its_time_constant():
    world = resting(force={**QUIET_FORCE, "bandwidth_hz": 20.0, "rate_hz": 4000.0})
    world.object.move_surface(0.01)  # from 10 N to 15 N
    samples = sample_each_step(world, world.force_sensor, 0.1)
    rise = (np.array([s.value[0] for s in samples]) - 10.0) / 5.0
    times = np.array([s.sampled_at_s for s in samples])
    time_constant_s = 1 / (2 * np.pi * 20.0)
    assert np.interp(1 - np.exp(-1), rise, times) == pytest.approx(time_constant_s, abs=0.5e-3)
    assert rise[-1] == pytest.approx(1.0, abs=1e-3)


def test_encoders_have_discrete_counts():
    world = falling(encoder={"counts_per_revolution": 4096.0})
    samples = sample_each_step(world, world.encoder, 0.2)
    counts = np.array([s.value[0] for s in samples]) / (2 * np.pi / 4096.0)
    assert np.allclose(counts, np.round(counts), atol=1e-6)


def velocity_error(world, duration_s=0.5):
    samples = sample_each_step(world, world.encoder, duration_s)
    times = np.array([s.sampled_at_s for s in samples])
    world.close()
    return np.array([s.value[1] for s in samples]) - -9.81 * times


def test_velocity_by_difference_lags_and_a_tachometer_does_not():
    fine = {"counts_per_revolution": 1e12, "velocity": {"bandwidth_hz": 100.0}}
    error = velocity_error(falling(encoder=fine))
    filter_delay_s = 1 / (2 * np.pi * 100.0)
    settled = error[-500:]
    # The engine's half-step start and the sampled filter shift the lag by less than a step.
    assert settled.mean() / 9.81 == pytest.approx(filter_delay_s, abs=0.25e-3)
    assert settled.std() < 1e-3

    def roughness(counts):
        return velocity_error(falling(encoder={"counts_per_revolution": counts}))[-1000:].std()

    assert roughness(8192.0) > 20 * roughness(819_200.0)
    assert roughness(819_200.0) < 0.006
    tachometer = {"velocity": {"source": "tachometer", "noise_std_rad_s": 0.02}}
    error = velocity_error(falling(encoder=tachometer))
    assert error.std() == pytest.approx(0.02, rel=0.1)
    assert abs(error.mean()) < 0.003


def all_readings(seed, **sensors):
    world = make_world(shipped_arm("follower"), scenario(surface_m=-5.0, seed=seed, **sensors))
    rows = []
    for tick in range(1, 100):
        world.advance_to(tick * 1e-3)
        sampled = [s.read(world.time_s).value for s in (world.force_sensor, world.torque_sensor)]
        rows.append(np.concatenate([*sampled, world.encoder.read(world.time_s).value]))
    world.close()
    return np.array(rows)


def test_seeds_repeat_the_noise_and_sensors_have_independent_noise():
    first, again, other = all_readings(7), all_readings(7), all_readings(8)
    assert np.array_equal(first, again)
    assert (first[:, :4] != other[:, :4]).mean() > 0.8
    plain, finer = all_readings(7), all_readings(7, torque={"rate_hz": 4000.0, "noise_std_nm": 0.5})
    assert np.array_equal(plain[:, 0], finer[:, 0])
    assert not np.array_equal(plain[:, 1], finer[:, 1])
    rows = all_readings(1, force={"resolution_n": 0.0}, torque={"resolution_nm": 0.0})[:, :4]
    assert np.abs(np.corrcoef(rows.T) - np.eye(4)).max() < 0.35
    noisy = {"noise_std_n": 5.0}
    first, second = (make_world(slider(0.01), scenario(force=force)) for force in (noisy, QUIET_FORCE))
    assert np.array_equal(column(watch(first, 0.1), "force_n"), column(watch(second, 0.1), "force_n"))
