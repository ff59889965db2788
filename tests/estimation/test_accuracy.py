"""The presses of the accuracy measurements, and their bounds."""

import numpy as np
import pytest

from benchmarks.presses import Noise, Press
from palpate.estimation.contact_estimators import CONTACT_ESTIMATORS
from palpate.estimation.estimator import ContactLaw
from palpate.estimation.estimators.batch import Lsq
from tests.estimation.contact_data import channel, estimated

KELVIN_VOIGT = Press(ContactLaw(500.0, 20.0), count=1500)
HUNT_CROSSLEY = Press(ContactLaw(2000.0, 1500.0, 1.3, 1.3), count=2000)


def test_speed_is_the_derivative_of_depth():
    np.testing.assert_allclose(
        np.gradient(KELVIN_VOIGT.depth_m, 1e-3)[1:-1], KELVIN_VOIGT.speed_m_s[1:-1], atol=2e-3
    )


def test_bound_equals_the_scatter_of_least_squares_in_even_noise():
    """Of a linear law with Gaussian noise they reach it (Gauss and Markov)."""
    noise, errors = Noise(0.05), []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        found = Lsq().fit(KELVIN_VOIGT.regression(KELVIN_VOIGT.read(noise, rng)), rng=rng)
        errors.append([parameter.value for parameter in found.parameters] - KELVIN_VOIGT.truth)
    np.testing.assert_allclose(np.std(errors, axis=0), KELVIN_VOIGT.bound(noise), rtol=0.15)


def test_hunt_crossley_bound_matches_finite_differences():
    rows = []
    for step in np.diag(1e-6 * HUNT_CROSSLEY.truth):
        ahead, behind = (
            Press(ContactLaw(*values, values[2]), count=2000).force_n
            for values in (HUNT_CROSSLEY.truth + step, HUNT_CROSSLEY.truth - step)
        )
        rows.append((ahead - behind) / (2 * step.max()))
    slopes = np.array(rows).T / 0.02
    expected = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    np.testing.assert_allclose(HUNT_CROSSLEY.bound(Noise()), expected, rtol=1e-4)


@pytest.mark.parametrize(("k", "n"), [(500.0, 1.0), (5e3, 1.5), (1e5, 2.2)])
def test_hunt_crossley_is_recovered_over_its_range_with_outliers(k, n):
    press, noise, errors = Press(ContactLaw(k, k, n, n)), Noise(outliers=0.3), []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        force_n, estimator = press.read(noise, rng), CONTACT_ESTIMATORS["robust_hunt_crossley"]()
        errors.append(estimator.fit(press.depth_m, press.speed_m_s, force_n, rng=rng)[:3] - press.truth)
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < 1.8 * press.bound(noise))


@pytest.mark.parametrize(("outliers", "most"), [pytest.param(0.0, 1.35, marks=pytest.mark.slow), (0.3, 1.6)])
def test_robust_estimate_is_near_the_bound_in_exponent_and_gains(outliers, most):
    """Errors of 15 draws scatter by a sixth; 30 % of the samples lost cost 1.2."""
    noise, errors = Noise(outliers=outliers), []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        press = HUNT_CROSSLEY
        data = channel(press.read(noise, rng), press.depth_m, press.speed_m_s, press.time_s)
        found = estimated(data, "hunt_crossley", "robust")
        errors.append([parameter.value for parameter in found.parameters] - press.truth)
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < most * HUNT_CROSSLEY.bound(noise))
