"""A force sensor with an offset: its tare, and the tare error in intervals."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

from palpate.control.loop.task import Phase
from palpate.estimation.channel import Tare
from palpate.estimation.data.contact import find_contacts
from palpate.estimation.data.tick_channels import contact_channels
from palpate.estimation.statistics.uncertainty import common_error_covariance
from tests.estimation import contact_data
from tests.estimation.little_probe import hunt_crossley, kelvin_voigt, probe, ticks

SURFACE_M = 0.4321
BIAS_N = 0.5
OFFSET = "contact_offset.offset"


def biased(law, bias_n=BIAS_N, **settings):
    """The ticks of a probe; `bias_n` is one number or one a run."""
    recorded = probe(law, surface_m=SURFACE_M, **settings)
    recorded.force_n = recorded.force_n + np.broadcast_to(bias_n, recorded.run.max() + 1)[recorded.run]
    return ticks(recorded)


estimated = partial(contact_data.estimated, surface_found=True)


def misses_m(channel, found):
    """How far the estimated surface is off, and its standard error [m]."""
    return channel.surface.position_m + found[OFFSET].value - SURFACE_M, found[OFFSET].std_err


@pytest.mark.parametrize("name", ["lsq", "robust", "ransac"])
def test_surface_estimate_is_independent_of_the_sensor_zero(name):
    (channel,) = contact_channels(biased(kelvin_voigt(500.0, 20.0)), tared=True)
    miss_m, std_err_m = misses_m(channel, estimated(channel, "kelvin_voigt", name))
    assert abs(miss_m) < 4 * std_err_m < 4e-5


def test_sensor_zero_does_not_bias_the_exponent():
    session = biased(hunt_crossley(5000.0, 8000.0, 1.4))
    tared, raw = (
        estimated(contact_channels(session, tared=tared)[0], "hunt_crossley") for tared in (True, False)
    )
    truth = {"hunt_crossley.k": 5000.0, "hunt_crossley.b": 8000.0, "hunt_crossley.n": 1.4}
    for name, value in truth.items():
        assert abs(tared[name].value - value) < 4 * tared[name].std_err
        assert abs(raw[name].value - value) > 10 * abs(tared[name].value - value)


def test_each_run_has_its_own_zero():
    bias_n = np.array([0.5, -0.3, 1.1])
    (channel,) = contact_channels(biased(kelvin_voigt(500.0, 20.0), bias_n), tared=True)
    np.testing.assert_allclose(channel.tare.effort, bias_n, atol=5 * channel.tare.std_err.max())
    assert estimated(channel, "kelvin_voigt")["stiffness.k"].value == pytest.approx(500.0, rel=0.002)
    only = estimated(channel.of_runs(np.array([1, 2])), "kelvin_voigt")
    assert only["stiffness.k"].value == pytest.approx(500.0, rel=0.002)


def test_bias_stays_in_the_measured_force():
    session = biased(kelvin_voigt(500.0, 20.0))
    (raw,), (tared,) = (contact_channels(session, tared=tared) for tared in (False, True))
    assert raw.tare is None
    np.testing.assert_array_equal(raw.effort, session["force_n"])
    np.testing.assert_allclose(raw.effort - tared.effort, BIAS_N, atol=0.01)
    assert raw.surface == tared.surface


def test_surface_error_includes_the_tare_error():
    """A free-air mean over 150 samples is known to 1.6 mN, which no number of samples in contact shows."""
    scores, without = [], []
    for seed in range(8):
        session = biased(kelvin_voigt(200.0, 20.0), seed=seed, speeds=(0.15, 0.06))
        (channel,) = contact_channels(session, tared=True)
        for keep, into in ((channel.tare, scores), (None, without)):
            miss_m, std_err_m = misses_m(channel, estimated(replace(channel, tare=keep), "kelvin_voigt"))
            into.append(miss_m / std_err_m)
    honest, too_sure = (np.sqrt(np.mean(np.square(values))) for values in (scores, without))
    assert 0.7 < honest < 1.35
    assert too_sure > 1.3 * honest


def test_error_of_a_mean_is_right_for_colored_noise():
    means, errors = [], []
    for seed in range(200):
        noise = lfilter([0.02], [1.0, -0.8], np.random.default_rng(seed).standard_normal(400))
        (contact,) = find_contacts(noise, np.zeros(400, np.int64), np.full(400, Phase.FREE_AIR))
        means.append(contact.baseline_n)
        errors.append(contact.baseline_std_err_n)
    assert np.mean(errors) == pytest.approx(np.std(means), rel=0.25)


def test_common_error_covariance_matches_least_squares():
    rng = np.random.default_rng(1)
    columns = np.column_stack([rng.uniform(size=300), np.ones(300)])
    run = np.repeat([4, 7], 150)
    tare = Tare(np.array([4, 7]), np.zeros(2), np.array([0.2, 0.1]))
    draws = [
        np.linalg.lstsq(columns, rng.normal(0.0, tare.std_err)[(run == 7).astype(int)], rcond=None)[0]
        for _ in range(4000)
    ]
    found = common_error_covariance(columns, tare.index(run), tare.std_err)
    np.testing.assert_allclose(np.sqrt(np.diag(found)), np.std(draws, axis=0), rtol=0.05)
    np.testing.assert_allclose(found[0, 1], np.cov(np.array(draws).T)[0, 1], rtol=0.15, atol=1e-4)
