"""Simulated readings: noise, encoder grid and differentiation window of the channel."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import freqz, savgol_coeffs

from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.fit.measurement_model import (
    _identify_window,
    _low_frequency_noise,
    channel_derivative,
    identify_measurement_model,
    shuffle_noise,
)
from tests.estimation.presses import channel, motion
from tests.estimation.presses import long_session as session
from tests.estimation.swings import long_swings as swings
from tests.estimation.swings import read

SMOOTH = swings(1)
STEP = 2 * np.pi / 4096


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_simulated_position_is_as_noisy_as_measured(noise):
    measurement = identify_measurement_model(read(SMOOTH, noise=noise))
    drawn = [measurement.simulate(np.random.default_rng(seed)).position for seed in range(4)]
    off = np.array(drawn) - SMOOTH.position
    assert np.std(off) == pytest.approx(noise, rel=0.15)
    # another error each time, not the one that was measured
    assert abs(np.corrcoef(off[0], off[1])[0, 1]) < 0.1
    assert abs(np.corrcoef(off[0], measurement.data.position - SMOOTH.position)[0, 1]) < 0.1


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_simulated_encoder_keeps_its_steps(noise):
    """Its zero may lie anywhere between two of them."""
    measurement = identify_measurement_model(read(SMOOTH, step=STEP, noise=noise))
    assert measurement.step == pytest.approx(STEP)
    drawn = measurement.simulate(np.random.default_rng(0)).position
    steps = (drawn - drawn[0]) / STEP
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert np.std(drawn - SMOOTH.position) == pytest.approx(np.hypot(STEP / np.sqrt(12), noise), rel=0.15)
    assert (drawn != measurement.data.position).mean() > 0.2


@pytest.mark.parametrize("given", [{"step": STEP}, {"noise": 1e-3}])
def test_derivatives_follow_the_simulated_position_by_their_window(given):
    data = read(SMOOTH, **given)
    made = differentiate(data.time_s, data.position, data.run)
    measurement = identify_measurement_model(data)
    assert measurement.filters == made.half_windows
    one, two = (measurement.simulate(np.random.default_rng(seed)) for seed in (0, 1))
    apart = channel_derivative(data, one.position - two.position, made.half_windows[0], 1)
    assert one.velocity - two.velocity == pytest.approx(apart, abs=1e-9 * np.ptp(one.velocity))


def test_simulated_velocity_follows_its_position_or_has_its_own_noise():
    measurement = identify_measurement_model(read(SMOOTH, noise=1e-3))
    white = np.random.default_rng(3).normal(0.0, 1e-3, len(SMOOTH))
    expected = np.std(channel_derivative(SMOOTH, white, measurement.filters[0], 1))
    one, two = (measurement.simulate(np.random.default_rng(seed)).velocity for seed in (0, 1))
    assert np.std(one - two) / np.sqrt(2.0) == pytest.approx(expected, rel=0.25)
    noisy = SMOOTH.velocity + np.random.default_rng(1).normal(0.0, 0.2, len(SMOOTH))
    data = replace(read(SMOOTH, noise=1e-3), velocity=noisy)
    measurement = identify_measurement_model(data)
    one, two = (measurement.simulate(np.random.default_rng(seed)) for seed in (0, 1))
    assert np.std(one.velocity - SMOOTH.velocity) == pytest.approx(0.2, rel=0.15)
    assert np.std(one.velocity - two.velocity) == pytest.approx(0.2 * np.sqrt(2.0), rel=0.15)
    assert abs(np.corrcoef(one.velocity - SMOOTH.velocity, noisy - SMOOTH.velocity)[0, 1]) < 0.1
    np.testing.assert_array_equal(one.effort, data.effort)


def test_acceleration_follows_the_simulated_velocity_it_was_derived_from():
    noisy = SMOOTH.velocity + np.random.default_rng(1).normal(0.0, 0.05, len(SMOOTH))
    made = differentiate(SMOOTH.time_s, noisy, SMOOTH.run)
    measurement = identify_measurement_model(
        replace(read(SMOOTH, noise=1e-4), velocity=noisy, acceleration=made.velocity)
    )
    assert measurement.is_of_velocity
    assert measurement.filters == (None, made.half_windows[0])
    one, two = (measurement.simulate(np.random.default_rng(seed)) for seed in (0, 1))
    apart = channel_derivative(SMOOTH, one.velocity - two.velocity, made.half_windows[0], 1)
    assert one.acceleration - two.acceleration == pytest.approx(apart, abs=1e-9 * np.ptp(one.acceleration))


def through_an_arm(x, steps, start):
    """Tips of joints whose encoders step, each with its own share of the way and its own zero."""
    share = np.array([0.7, 0.5, -0.2])
    return sum(
        np.round(s * x / step + o) * step - o * step for s, step, o in zip(share, steps, start, strict=True)
    )


def test_simulated_joint_steps_match_the_encoder():
    """Its tip lies on no grid: each joint's encoder steps at places of its own."""
    rng, steps = np.random.default_rng(2), np.array([0.2, 0.13, 0.05])
    slow = replace(SMOOTH, time_s=10.0 * SMOOTH.time_s)
    read_by_arm = [through_an_arm(SMOOTH.position, steps, rng.random(3)) for _ in range(2)]
    measurement = identify_measurement_model(replace(slow, position=read_by_arm[0]))
    assert measurement.is_staircase
    off = [measurement.simulate(rng).position - measurement.smoothed_motion.position for _ in range(12)]
    assert np.std(off, axis=1) == pytest.approx(np.sqrt(np.sum(steps**2) / 12.0), rel=0.25)
    alike = np.corrcoef(off)[np.triu_indices(len(off), 1)]
    assert abs(np.mean(alike)) < 0.15  # of any sign, as steps at other places are


def test_smoothed_motion_is_nearer_the_truth_than_the_reading():
    data = read(swings(2), noise=2e-3)
    true = identify_measurement_model(data).smoothed_motion
    exact = swings(2)
    for signal, share in (("position", 0.6), ("acceleration", 0.7), ("velocity", 1.0)):
        off, read_off = (getattr(one, signal) - getattr(exact, signal) for one in (true, data))
        assert np.std(off) < share * np.std(read_off)


def test_derivative_matches_a_cubic_within_its_run():
    data = session(1)
    cubic = (data.time_s - data.time_s.mean()) ** 3 + 5.0 * data.run
    inside = channel_derivative(data, cubic, 5, 1)
    assert inside == pytest.approx(3.0 * (data.time_s - data.time_s.mean()) ** 2, rel=1e-6, abs=1e-6)


def test_shuffled_noise_keeps_its_values_without_order():
    rng = np.random.default_rng(0)
    run = np.repeat([0, 1], 400)
    noise = np.convolve(rng.normal(size=804), np.ones(5), "valid")
    made = np.array([shuffle_noise(noise, run, rng) for _ in range(40)])
    assert np.sort(np.abs(made[:, :400])) == pytest.approx(np.tile(np.sort(np.abs(noise[:400])), (40, 1)))
    assert np.mean(np.abs([np.corrcoef(noise, one)[0, 1] for one in made])) < 0.15


def test_windows_are_recognized_in_long_runs_and_separate_pieces():
    data = read(swings(2, runs=3, seconds=9.0, rate_hz=500.0), step=STEP)
    made = differentiate(data.time_s, data.position, data.run)
    assert identify_measurement_model(data).filters == made.half_windows
    assert made.half_windows[1] > 14
    # As a session's are, whose samples have gaps: near these the derivatives are others.
    noisy = read(SMOOTH, noise=1e-4)
    made = differentiate(noisy.time_s, noisy.position, np.arange(len(noisy)) // 150, 10)
    data = replace(noisy, velocity=made.velocity, acceleration=made.acceleration)
    assert identify_measurement_model(data).filters == (10, 10)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("noise", "off", "known"),
    [
        (0.0, 0.99e-3, True),  # of the derivative itself
        (0.0, 1.01e-3, False),
        (1e-3, 0.99 * np.sqrt(0.5), True),  # of what the window makes of the noise
        (1e-3, 1.01 * np.sqrt(0.5), False),
    ],
)
def test_derivative_may_deviate_by_a_thousandth_or_half_its_noise(sign, noise, off, known, monkeypatch):
    monkeypatch.setattr("palpate.estimation.fit.measurement_model.HALF_WINDOWS", (10,))
    position = sign * SMOOTH.position
    error = noise * np.random.default_rng(1).normal(size=len(SMOOTH))
    given = channel_derivative(SMOOTH, position, 10, 1)
    unit = np.sqrt(np.median(channel_derivative(SMOOTH, error, 10, 1) ** 2) if noise else np.mean(given**2))
    given = given + off * unit * np.resize([1.0, -1.0], len(given))
    assert (_identify_window(SMOOTH, position, error, given, 1)[0] is not None) is known


def test_simulated_encoder_steps_are_equal_at_low_speed():
    """A smoothing window follows them there: what it leaves is too small."""
    rng, steps = np.random.default_rng(2), np.array([4e-4, 2.6e-4, 1e-4])
    time_s, place, _, run = motion(rng)
    data = channel(0.0 * place, time_s, through_an_arm(place, steps, rng.random(3)), 0.0 * place, run)
    made = differentiate(data.time_s, data.position, data.run)
    measurement = identify_measurement_model(
        replace(data, velocity=made.velocity, acceleration=made.acceleration)
    )
    rests = np.abs(np.gradient(place, time_s)) < 0.003
    off = [
        (measurement.simulate(rng).position - measurement.smoothed_motion.position)[rests] for _ in range(12)
    ]
    assert measurement.is_staircase
    assert np.std(off) == pytest.approx(np.sqrt(np.sum(steps**2) / 12.0), rel=0.3)


def test_acceleration_derived_from_a_derived_velocity_is_recognized():
    data = read(SMOOTH, noise=1e-4)
    velocity = channel_derivative(data, data.position, 3, 1)
    twice = replace(data, velocity=velocity, acceleration=channel_derivative(data, velocity, 5, 1))
    measurement = identify_measurement_model(twice)
    assert measurement.filters == (3, 5)
    assert measurement.is_of_velocity
    drawn = (
        measurement.simulate(np.random.default_rng(1)).acceleration - measurement.smoothed_motion.acceleration
    )
    # more than the reading's: what noise the exact motion still has is bent, too
    assert 0.8 < np.std(drawn) / np.std(twice.acceleration - SMOOTH.acceleration) < 1.6


@pytest.mark.parametrize("half", [10, 25, 50])
def test_hidden_noise_is_simulated_up_to_half_the_window_response(half):
    """White noise less what a cubic through the window follows, with what is drawn for that, is white."""
    turn, passed = freqz(savgol_coeffs(2 * half + 1, 3), worN=np.pi * np.linspace(1e-3, 0.5, 2000))
    edge = turn[np.argmax(np.abs(passed) < 0.5)] / (2.0 * np.pi)  # in cycles a sample
    rng, run = np.random.default_rng(half), np.repeat(np.arange(20), 500)
    frequency, power = np.fft.rfftfreq(500), 0.0
    white = np.fft.rfft(rng.normal(size=(20, 500)), axis=1) * (frequency > edge)
    error = np.fft.irfft(white, 500, axis=1).ravel()
    drawn = [_low_frequency_noise(error, run, half, rng).reshape(20, 500) for _ in range(10)]
    power = np.mean([np.abs(np.fft.rfft(one, axis=1)) ** 2 for one in drawn], axis=(0, 1)) / 500.0
    assert power[0] == pytest.approx(0.0, abs=1e-12)
    assert power[(frequency > 0.0) & (frequency < 0.85 * edge)].mean() == pytest.approx(1.0, rel=0.25)
    assert power[frequency > 1.25 * edge].max() < 1e-12
    whole = np.random.default_rng(1).normal(size=10_000)  # hides nothing: little is added
    assert np.std(_low_frequency_noise(whole, run, half, rng)) < 0.8 * np.sqrt(2.0 * edge)
    assert not _low_frequency_noise(np.zeros(10_000), run, half, rng).any()
    assert np.isfinite(_low_frequency_noise(whole, np.repeat(np.arange(2500), 4), 200, rng)).all()


def test_noiseless_derivatives_are_recognized_and_debiased():
    halves = (3, 20)
    velocity, acceleration = (
        channel_derivative(SMOOTH, SMOOTH.position, h, k) for k, h in enumerate(halves, start=1)
    )
    measurement = identify_measurement_model(replace(SMOOTH, velocity=velocity, acceleration=acceleration))
    assert measurement.filters == halves
    for name in ("position", "velocity", "acceleration"):
        exact = getattr(SMOOTH, name)
        off, bent = (
            np.std(getattr(one, name) - exact) for one in (measurement.smoothed_motion, measurement.data)
        )
        assert off < max(0.5 * bent, 1e-4 * np.std(exact)), name
        drawn = getattr(measurement.simulate(np.random.default_rng(0)), name)
        assert np.std(drawn - getattr(measurement.data, name)) < 5e-3 * np.std(exact), name


def test_resting_samples_keep_their_readings_in_simulation():
    rest = replace(SMOOTH, position=0.0 * SMOOTH.position, velocity=0.0 * SMOOTH.velocity)
    for data in (rest, replace(rest, acceleration=0.0 * rest.velocity)):
        measurement = identify_measurement_model(data)
        assert measurement.filters == (None, None)
        drawn = measurement.simulate(np.random.default_rng(0))
        assert not drawn.velocity.any()
        assert drawn.acceleration == pytest.approx(data.acceleration)


def test_pause_within_a_run_adds_no_error_to_the_simulated_motion():
    """Pieces of a long test, of which only some cycles were kept, are derived each by itself."""
    read_once = read(SMOOTH, noise=1e-3)
    half = np.arange(len(read_once)) % np.sum(read_once.run == 0) >= np.sum(read_once.run == 0) // 2
    time_s = read_once.time_s + 400.0 * half + 1000.0 * read_once.run
    made = differentiate(time_s, read_once.position, 2 * read_once.run + half)
    paused = replace(read_once, time_s=time_s, velocity=made.velocity, acceleration=made.acceleration)
    drawn = identify_measurement_model(paused).simulate(np.random.default_rng(0))
    whole = identify_measurement_model(read_once).simulate(np.random.default_rng(0))
    limit = 1.5 * np.std(whole.velocity - read_once.velocity)
    assert np.std(drawn.velocity - paused.velocity) < limit
