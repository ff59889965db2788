from functools import cache

import numpy as np
import pytest

from palpate.calibration.force import find_plateaus, fit_force, implausible_force, plateaus_of
from palpate.robot_io.errors import InputError

UP_AND_DOWN_N = [0.0, 5.0, 10.0, 20.0, 30.0, 40.0, 30.0, 20.0, 10.0, 5.0, 0.0]


def record(rng, *, zero=1.3, gain=0.9, bend=0.0, play=0.0, noise=0.02, step=0.02):
    """Plateaus of a sensor with these faults; `step` is what differs from plateau to plateau [u]."""
    pieces, side = [], 0.0
    for before, force in zip([UP_AND_DOWN_N[0], *UP_AND_DOWN_N], UP_AND_DOWN_N, strict=False):
        side = np.sign(force - before)
        level = gain * force * (1 + bend * force) + zero - side * play + rng.normal(0, step)
        pieces.append(level + rng.normal(0, noise, 200))
    return plateaus_of(UP_AND_DOWN_N, pieces)


@cache
def straight(seed):
    """Fit the calibration of a linear sensor."""
    return fit_force(record(np.random.default_rng(seed)))


def test_scale_and_zero_are_estimated_within_their_uncertainty():
    """2 standard uncertainties cover 95 % of 200 sensors, to within 2.5 deviations of that count."""
    covered = np.zeros(2)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        zero, gain = rng.uniform(-2, 2), rng.uniform(0.8, 1.2)
        fit = fit_force(record(rng, zero=zero, gain=gain))
        covered += [
            abs(fit.zero.value - zero) < 2 * fit.zero.std_err,
            abs(fit.scale.value - 1 / gain) < 2 * fit.scale.std_err,
        ]
    assert np.all(np.abs(covered / 200 - 0.95) < 0.04), covered / 200


def test_curvature_and_hysteresis_are_distinguished():
    fit = fit_force(record(np.random.default_rng(1), bend=3e-4, play=0.15))
    assert fit.curvature is not None
    assert fit.curvature.value == pytest.approx(-3e-4 / 0.9**2, rel=0.3)
    assert fit.hysteresis_n.value == pytest.approx(2 * 0.15 / 0.9, rel=0.2)
    assert fit.nonlinearity.value == pytest.approx(3e-4 * 40 / 4, rel=0.3)


@pytest.mark.parametrize("bend", [6e-6, 5e-5, 2e-4, 5e-4, 2e-3])
def test_uncertainty_covers_a_curve_that_is_no_parabola(bend):
    """40 sensors, with play: at most five of either value outside of two deviations (binomial, 1 %)."""
    outside = np.zeros(2)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        zero, gain, side = rng.uniform(-2, 2), rng.uniform(0.9, 1.1), rng.choice([-1, 1])
        shape = {"bend": side * bend, "play": rng.uniform(0.01, 0.05), "step": 0.001}
        fit = fit_force(record(rng, zero=zero, gain=gain, **shape))
        force = np.array(UP_AND_DOWN_N)
        mean_slope = np.polyfit(gain * force * (1 + side * bend * force), force, 1)[0]
        slope = 1 / gain if fit.curvature else mean_slope
        outside += [
            abs(fit.zero.value - zero) > 2 * fit.zero.std_err,
            abs(fit.scale.value - slope) > 2 * fit.scale.std_err,
        ]
    assert np.all(outside <= 5), outside


def test_straight_sensor_keeps_a_small_uncertainty():
    """Its scale is stated as a line with Student's t states it, no wider."""
    scatter, stated = [], []
    for seed in range(100):
        scale = straight(seed).scale
        scatter.append(scale.value - 1 / 0.9)
        stated.append(scale.std_err)
    assert np.mean(stated) < 1.35 * np.std(scatter)


def test_three_forces_show_no_curvature():
    """A parabola goes through any three points: nothing would tell that the sensor follows one."""
    forces = [0.0, 20.0, 40.0, 20.0, 0.0, 20.0, 40.0]
    rng = np.random.default_rng(6)
    pieces = [force * (1 + 1e-3 * force) + rng.normal(0, 0.001, 50) for force in forces]
    fit = fit_force(plateaus_of(forces, pieces))
    assert fit.curvature is None
    assert fit.scale.value == pytest.approx(1 / 1.04, rel=0.01)
    assert fit.scale.std_err > 0.001


def test_straight_sensor_is_rarely_called_curved():
    assert np.mean([straight(seed).curvature is not None for seed in range(150)]) < 0.04


def test_calibrated_sensor_is_accurate_over_its_range():
    fit = fit_force(record(np.random.default_rng(2), bend=1e-4, step=0.0))
    assert fit.rms_n < 0.01
    assert fit.suspect is None


def test_common_weight_error_enters_the_scale_and_a_wrong_weight_is_named():
    plateaus = record(np.random.default_rng(3))
    one, other = fit_force(plateaus), fit_force(plateaus, reference_rel_std=0.01)
    assert other.scale.value == one.scale.value
    assert other.scale.std_err == pytest.approx(np.hypot(one.scale.std_err, 0.01 * one.scale.value))
    plateaus = record(np.random.default_rng(4))
    plateaus.reading[3] += 3.0
    assert fit_force(plateaus).suspect == 3


def test_glitches_and_settling_are_excluded():
    rng = np.random.default_rng(5)
    reference = np.repeat(UP_AND_DOWN_N, 200)
    reading = reference + rng.normal(0, 0.02, len(reference))
    reading[[150, 551, 1190]] = -8388608.0
    plateaus = find_plateaus(reading, reference)
    assert plateaus.glitches == 3
    assert fit_force(plateaus).scale.value == pytest.approx(1.0, abs=1e-3)
    reference = np.repeat(UP_AND_DOWN_N, 100)
    settling = np.tile(np.exp(-np.arange(100) / 4.0), len(UP_AND_DOWN_N))
    marked = settling < 1e-4
    assert np.abs(find_plateaus(reference + settling, reference, marked).reading - UP_AND_DOWN_N).max() < 1e-4
    assert np.abs(find_plateaus(reference + settling, reference).reading - UP_AND_DOWN_N).max() < 1e-3


def bench(rng, *, drift=0.0, tau=0.0, most=np.inf, least=-np.inf, noise=0.02):
    """A record of the plateaus' samples, at 100 Hz: reading and reference; true scale 1 / 0.9, zero 1.2."""
    reference = np.repeat(UP_AND_DOWN_N, 150)
    before = np.repeat([0.0, *UP_AND_DOWN_N[:-1]], 150)
    time_s = np.arange(len(reference)) / 100.0
    lag = np.exp(-(time_s % 1.5) / tau) if tau else 0.0
    force = reference + (before - reference) * lag
    plateau = np.repeat(rng.normal(0, 0.005, len(UP_AND_DOWN_N)), 150)
    reading = 1.2 + 0.9 * force + drift * time_s + plateau + rng.normal(0, noise, len(force))
    return np.clip(reading, least, most), reference


@pytest.mark.parametrize(
    ("limits", "lost_n"),
    [
        ({"most": 25.0}, {30.0, 40.0}),  # two forces give the same largest reading
        ({"most": 30.0}, {40.0}),  # one plateau is constant, all others are noisy
        ({"least": 3.0}, {0.0}),
    ],
)
def test_saturated_plateaus_are_left_out(limits, lost_n):
    plateaus = find_plateaus(*bench(np.random.default_rng(1), **limits))
    fit = fit_force(plateaus)
    assert set(plateaus.reference_n[~fit.is_used]) == lost_n
    assert fit.scale.value == pytest.approx(1 / 0.9, abs=3 * fit.scale.std_err)
    assert fit.scale.std_err < 0.005
    assert not implausible_force(fit)


def test_saturation_that_leaves_too_few_plateaus_is_refused():
    with pytest.raises(InputError, match=r"9 of 11 plateaus, at 5, 10, 20, 30, 40 N, .* saturated\. Too few"):
        fit_force(find_plateaus(*bench(np.random.default_rng(1), most=4.0)))


@pytest.mark.parametrize("noise", [0.0, 0.004])
def test_coarse_resolution_is_not_read_as_saturation(noise):
    reading, reference = bench(np.random.default_rng(3), noise=noise)
    assert fit_force(find_plateaus(np.round(reading / 0.1) * 0.1, reference)).is_used.all()


def test_reference_shifted_by_half_a_plateau_is_implausible():
    reading, reference = bench(np.random.default_rng(2))
    reasons = implausible_force(fit_force(find_plateaus(reading, np.roll(reference, 75))))
    assert any("% of the range" in reason for reason in reasons)
    assert any("known only to" in reason for reason in reasons)
    assert not implausible_force(fit_force(find_plateaus(reading, reference)))


def test_drift_is_named_and_the_zero_covers_start_and_end():
    covered = []
    for seed in range(20):
        fit = fit_force(find_plateaus(*bench(np.random.default_rng(seed), drift=0.01)))
        assert fit.drift_n is not None
        assert fit.drift_n.value == pytest.approx(0.165 / 0.9, abs=4 * fit.drift_n.std_err)
        covered += [abs(fit.zero.value - zero) < 2 * fit.zero.std_err for zero in (1.2, 1.2 + 0.165)]
        assert abs(fit.hysteresis_n.value) < 4 * fit.hysteresis_n.std_err
    assert np.mean(covered) > 0.9
    steady = [
        fit_force(find_plateaus(*bench(np.random.default_rng(seed)))).drift_n is None for seed in range(40)
    ]
    assert np.mean(steady) > 0.9


def test_slow_settling_is_named_and_does_not_pass_for_hysteresis():
    fit = fit_force(find_plateaus(*bench(np.random.default_rng(1), tau=0.15)))
    assert fit.unsettled_n > 0.05
    assert abs(fit.hysteresis_n.value) < 2 * fit.hysteresis_n.std_err
    assert not fit_force(find_plateaus(*bench(np.random.default_rng(1)))).unsettled_n


@pytest.mark.parametrize(
    ("forces", "readings", "words"),
    [
        ([0.0, 1.0, 0.0, 1.0, 0.0, 1.0], [0, 1, 0, 1, 0, 1], "at 2 different forces"),
        ([0.0, 1.0, 2.0], [0, 1, 2], "3 plateaus"),
        ([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0], [0, -1, -2, -3, -2, -1, 0], "reverse the sign of the sensor"),
        ([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0], [5] * 7, "does not respond"),
    ],
)
def test_invalid_calibration_is_refused(forces, readings, words):
    rng = np.random.default_rng(0)
    noise = 0.0 if len(set(readings)) == 1 else 0.01
    pieces = [np.full(50, float(reading)) + noise * rng.normal(size=50) for reading in readings]
    with pytest.raises(InputError, match=words):
        fit_force(plateaus_of(forces, pieces))
