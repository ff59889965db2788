"""The noise of a channel: recovered where it is known, bounded where it is not, and moved by no model."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.fit.fit_result import fit_model
from estimation.fit.measurement_noise import NoiseSource, measurement_noise
from tests.estimation.fits import MODEL, cubic, fits
from tests.estimation.presses import NOISE_N, session
from tests.estimation.searches import SWING
from tests.estimation.swings import NOISE_NM, swings


def noise_of(data, model=MODEL):
    return measurement_noise(fit_model(data, model, {}))


@pytest.mark.parametrize("law", [None, cubic])
def test_free_air_tells_the_noise_whatever_the_object_does(law):
    found = noise_of(session(4, law) if law else session(4))
    assert found.source is NoiseSource.FREE_AIR
    assert found.value == pytest.approx(NOISE_N, rel=0.1)
    assert not found.is_bound


def test_differences_of_readings_tell_the_noise_of_a_joint_whatever_is_missing():
    found = noise_of(swings(2, lambda q, v, a: 0.1 * np.tanh(v / 0.02) + 6.0 * q), SWING)
    assert found.source is NoiseSource.NEIGHBORS
    assert found.value == pytest.approx(NOISE_NM, rel=0.1)


def test_errors_of_the_position_count_as_noise_as_the_model_passes_them_on():
    data, error_m = session(4), 1e-4
    read = data.position + np.random.default_rng(3).normal(0.0, error_m, len(data))
    base = fit_model(replace(data, position=read), MODEL, {})
    stiffness = base.solution.parameters["stiffness.k"]
    found = measurement_noise(base)
    assert found.motion == pytest.approx(
        stiffness * error_m * np.sqrt(np.mean(data.engaged[base.judged])), rel=0.25
    )
    assert found.value == pytest.approx(base.rmse, rel=0.15)


def test_a_sensor_that_shows_zero_in_free_air_says_nothing_there():
    data = session(4)
    found = noise_of(replace(data, effort=np.where(data.engaged, data.effort, 0.0)))
    assert found.source is not NoiseSource.FREE_AIR
    assert found.value == pytest.approx(NOISE_N, rel=0.2)


def slow_noise(count, size):
    white = np.random.default_rng(5).normal(size=count + 40)
    smooth = np.convolve(white, np.hanning(40), "same")[20:-20]
    return size * smooth / smooth.std()


def test_slow_noise_is_bounded_by_runs_that_repeat_a_motion():
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


def test_no_effect_that_is_added_moves_it():
    base, grown = fits(session(4, cubic), MODEL, ["cubic_stiffness"])
    assert grown.rmse < 0.2 * base.rmse
    assert measurement_noise(base).value == pytest.approx(measurement_noise(grown).value, rel=0.05)
