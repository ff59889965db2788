"""Measurement noise, permutation tests, and what is reported of the residual."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import FitResult, fit_model
from palpate.estimation.fit.measurement_noise import (
    MeasurementNoise,
    NoiseSource,
    fast_noise,
    measurement_noise,
)
from palpate.estimation.fit.permutation import COUNT, _surrogate_residuals, null_improvements
from tests.estimation.fits import MODEL, cubic, fits
from tests.estimation.presses import NOISE_N
from tests.estimation.presses import long_session as session
from tests.estimation.searches import SWING
from tests.estimation.swings import NOISE_NM
from tests.estimation.swings import long_swings as swings


def noise_of(data, model=MODEL):
    return measurement_noise(fit_model(data, model, {}))


@pytest.mark.parametrize("law", [None, cubic])
def test_free_air_noise_is_independent_of_the_object(law):
    found = noise_of(session(4, law) if law else session(4))
    assert found.source is NoiseSource.FREE_AIR
    assert found.value == pytest.approx(NOISE_N, rel=0.1)
    assert not found.is_bound


@pytest.mark.parametrize("slow_times", [0.0, 8.0])
def test_noise_that_grows_with_force_is_estimated_from_the_whole_recording(slow_times):
    """Neighboring readings share a slow error at the object, so that they tell the growing noise alone."""
    quiet = session(4)
    growing = 0.1 * np.abs(quiet.effort) * np.random.default_rng(3).normal(size=len(quiet))
    everywhere = np.sqrt(NOISE_N**2 + np.mean(growing**2))
    slow = np.where(quiet.engaged, slow_noise(len(quiet), slow_times * everywhere), 0.0)
    found = noise_of(replace(quiet, effort=quiet.effort + growing + slow))
    assert found.source is NoiseSource.NEIGHBORS
    assert everywhere > 1.5 * NOISE_N
    assert found.value == pytest.approx(everywhere, rel=0.2)


def test_differences_of_readings_estimate_joint_noise():
    found = noise_of(swings(2, lambda q, v, a: 0.1 * np.tanh(v / 0.02) + 6.0 * q), SWING)
    assert found.source is NoiseSource.NEIGHBORS
    assert found.value == pytest.approx(NOISE_NM, rel=0.1)


@pytest.mark.parametrize("times", [10.0, 100.0])
def test_friction_that_jumps_at_reversals_is_no_noise(times):
    data = swings(1, lambda q, v, a: times * NOISE_NM * np.tanh(v / 0.02))
    assert fast_noise(data) == pytest.approx(NOISE_NM, rel=0.1)


def test_the_error_of_a_model_contains_the_noise():
    bound = MeasurementNoise(0.4, NoiseSource.FLEXIBLE, None, 0.0)
    assert bound.below(0.5) == bound
    assert bound.below(0.1) == MeasurementNoise(0.1, NoiseSource.MODEL, None, 0.0)
    assert bound.below(0.39) == replace(bound, value=0.39)
    measured = replace(bound, effort=0.4)
    assert measured.below(0.1) == measured  # by chance


@pytest.mark.parametrize(("count", "is_known"), [(55, False), (56, True)])
def test_noise_needs_fifty_differences_of_readings(count, is_known):
    few = swings(2).select(np.arange(count))
    assert (
        fast_noise(replace(few, effort=np.random.default_rng(0).normal(size=count))) is not None
    ) is is_known


def test_sample_and_hold_steps_and_few_jumps_are_no_noise():
    data = swings(2, lambda q, v, a: 0.0 * q)
    position = 0.01 * np.arange(len(data)) // 0.2 * 0.2  # a step every twenty readings
    cogging = 10.0 * NOISE_NM * np.sin(7.3 * position / 0.2)
    held = replace(data, position=position, velocity=0.0 * position, acceleration=0.0 * position)
    found = noise_of(replace(held, effort=data.effort + cogging), SWING)
    assert found.source is NoiseSource.NEIGHBORS
    assert found.value == pytest.approx(NOISE_NM, rel=0.1)
    data = swings(2, lambda q, v, a: 6.0 * q)
    effort = data.effort.copy()
    effort[len(data) // 3 :] -= 500.0 * NOISE_NM
    effort[len(data) // 2 :] += 900.0 * NOISE_NM
    assert fast_noise(replace(data, effort=effort)) == pytest.approx(NOISE_NM, rel=0.05)


def test_position_errors_count_as_noise_through_the_model():
    data, error_m = session(4), 1e-4
    read = data.position + np.random.default_rng(3).normal(0.0, error_m, len(data))
    base = fit_model(replace(data, position=read), MODEL, {})
    stiffness = base.solution.parameters["stiffness.k"]
    found = measurement_noise(base)
    assert measurement_noise(base) is found  # estimated once
    assert found.motion == pytest.approx(
        stiffness * error_m * np.sqrt(np.mean(data.engaged[base.scored])), rel=0.25
    )
    assert found.value == pytest.approx(base.rmse, rel=0.15)


def test_contact_made_or_lost_by_a_reading_error_is_no_noise():
    """The force of a damper jumps at the surface, which a wrong model may put among the scored samples."""
    data = session(4)
    errors_m = np.random.default_rng(0).normal(0.0, 1e-5, len(data))
    data = replace(data, position=data.position + errors_m)
    base = fit_model(data, MODEL.with_effect(EFFECTS["contact_offset"]()), {})
    surface_m = data.position[base.scored & (data.velocity > 0.05) & (data.position > 0.001)].min()
    parameters = {**base.solution.parameters, "contact_offset.offset": float(surface_m)}
    moved = replace(base, solution=replace(base.solution, parameters=parameters))
    assert measurement_noise(moved).motion == pytest.approx(measurement_noise(base).motion, rel=0.1)


def test_noise_in_words_names_errors_of_the_motion_if_they_matter():
    noise = MeasurementNoise(0.03, NoiseSource.FREE_AIR, 0.02, 0.022)
    assert noise.describe("N") == "0.0300 N, from free air and errors of the motion"
    assert replace(noise, value=0.021).describe("N") == "0.0210 N, from free air"


def test_zero_readings_in_free_air_give_no_noise_estimate():
    data = session(4)
    found = noise_of(replace(data, effort=np.where(data.engaged, data.effort, 0.0)))
    assert found.source is not NoiseSource.FREE_AIR
    assert found.value == pytest.approx(NOISE_N, rel=0.2)


def slow_noise(count, size):
    white = np.random.default_rng(5).normal(size=count + 40)
    smooth = np.convolve(white, np.hanning(40), "same")[20:-20]
    return size * smooth / smooth.std()


def test_slow_noise_is_bounded_by_repeated_runs():
    data = swings(1)
    once = data.run == 0
    runs = [data.select(once)] * 4
    count = int(once.sum())
    data = data.select(np.tile(np.flatnonzero(once), len(runs)))
    data = replace(
        data,
        run=np.repeat(np.arange(len(runs)), count),
        time_s=np.concatenate([data.time_s[:count] + 100.0 * number for number in range(len(runs))]),
        effort=data.effort + slow_noise(len(data), 5 * NOISE_NM) + 0.3 * np.sin(9.0 * data.position),
    )
    found = noise_of(data, SWING)
    assert found.is_bound
    assert found.value == pytest.approx(5 * NOISE_NM, rel=0.3)
    assert found.describe("N m").startswith("at most ")


def test_added_effect_does_not_change_the_noise():
    base, grown = fits(session(4, cubic), MODEL, ["cubic_stiffness"])
    assert grown.rmse < 0.2 * base.rmse
    assert measurement_noise(base).value == pytest.approx(measurement_noise(grown).value, rel=0.05)


RUN = np.repeat([0, 1], 500)


def test_surrogates_keep_values_and_spectrum_of_the_noise():
    rng = np.random.default_rng(3)
    noise = np.convolve(rng.normal(size=1004), np.ones(5), "valid")
    made = _surrogate_residuals(noise, RUN, rng)
    assert np.sort(np.abs(made[:500]), axis=0) == pytest.approx(
        np.sort(np.abs(noise[:500]))[:, None] + np.zeros(COUNT)
    )
    neighbours = [np.corrcoef(one[1:500], one[:499])[0, 1] for one in made.T]
    assert np.mean(neighbours) == pytest.approx(0.8, abs=0.05)
    assert np.mean([abs(np.corrcoef(noise, one)[0, 1]) for one in made.T]) < 0.15


def test_gains_of_white_noise_follow_the_beta_distribution():
    rng = np.random.default_rng(4)
    base, more = rng.normal(size=(1000, 2)), rng.normal(size=(1000, 3))
    found = null_improvements(rng.normal(size=1000), RUN, base, [np.hstack([base, more])], rng)
    assert len(found) == COUNT
    assert stats.kstest(found, stats.beta(1.5, 497.5).cdf).pvalue > 0.01


def test_best_of_many_candidates_gains_more_than_one():
    rng = np.random.default_rng(5)
    base, noise = np.ones((1000, 1)), rng.normal(size=1000)
    tried = [np.hstack([base, rng.normal(size=(1000, 1))]) for _ in range(30)]
    one, best = (np.median(null_improvements(noise, RUN, base, some, rng)) for some in (tried[:1], tried))
    expected = stats.chi2(1).ppf(0.5 ** (1 / 30)) / 999  # median of the largest of thirty
    assert best == pytest.approx(expected, rel=0.15)
    assert one < 0.2 * best


def test_slow_noise_favors_a_slow_law():
    rng = np.random.default_rng(6)
    base = np.ones((1000, 1))
    slow = np.hstack([base, np.sin(np.arange(1000) / 40.0)[:, None]])

    def gain(width):
        """Of noise averaged over so many samples; ten recordings, since each has little of so slow a wave."""
        made = [np.convolve(rng.normal(size=999 + width), np.ones(width), "valid") for _ in range(10)]
        return np.mean([null_improvements(noise, RUN, base, [slow], rng) for noise in made])

    assert gain(20) > 5.0 * gain(1)


def test_zero_columns_gain_nothing():
    rng = np.random.default_rng(6)
    base, noise = np.ones((1000, 1)), rng.normal(size=1000)
    again = np.hstack([base, 3.0 * base, np.zeros((1000, 1))])
    assert null_improvements(noise, RUN, base, [again], rng) == pytest.approx(0.0, abs=1e-6)
    assert null_improvements(noise, RUN, np.empty((1000, 0)), [], rng) == pytest.approx(0.0)


@pytest.mark.parametrize(("rmse", "exact"), [(0.0, True), (2e-7, True), (2.1e-7, False)])
def test_single_precision_is_no_noise(rmse, exact):
    fit = SimpleNamespace(training=SimpleNamespace(effort=np.array([2.0, -2.0, 2.0])), rmse=rmse)
    assert FitResult.is_exact.fget(fit) is exact


@pytest.mark.parametrize(
    ("shares", "told"),
    [
        ({"velocity": 0.2, "time": 0.5, "load": 0.19}, ["time", "velocity"]),  # 40 % of the most telling
        ({"velocity": 0.01, "time": 0.009}, ["velocity"]),  # next to nothing is not told
        ({"velocity": 0.009, "time": 0.005}, []),
        ({}, []),
    ],
)
def test_signals_are_sorted_by_explained_error(shares, told):
    assert FitResult.depends_on.fget(SimpleNamespace(flexible=SimpleNamespace(by_signal=shares))) == told


def test_decided_permutation_test_stops_with_the_same_decision():
    rng = np.random.default_rng(7)
    noise, base = rng.normal(size=len(RUN)), np.ones((len(RUN), 1))
    tried = [np.hstack([base, rng.normal(size=(len(RUN), 3))]) for _ in range(20)]
    asked = []

    def candidates():
        for columns in tried:
            asked.append(columns)
            yield columns

    observed = float(np.quantile(null_improvements(noise, RUN, base, tried, np.random.default_rng(1)), 0.5))
    stopped = null_improvements(
        noise, RUN, base, candidates(), np.random.default_rng(1), observed=observed, most=1
    )
    assert np.sum(stopped >= observed) > 1  # as without a stop
    assert len(asked) < len(tried)
