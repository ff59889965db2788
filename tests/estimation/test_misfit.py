"""How far a model is off beside the noise: seen whatever the estimator, silent where only noise is left."""

import numpy as np
import pytest

from palpate.estimation.statistics.correlation import misfit

RUN = np.repeat([0, 1, 2], 1000)
ALL = np.ones(3000, dtype=bool)


def noise(sigma=0.02, seed=0):
    return np.random.default_rng(seed).normal(0.0, sigma, 3000)


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_is_no_misfit(seed):
    found = misfit(noise(seed=seed), RUN, ALL)
    assert found.noise == pytest.approx(0.02, rel=0.1)
    assert found.times == pytest.approx(1.0, rel=0.1)


def test_what_is_left_over_slowly_counts_and_what_a_robust_method_set_aside():
    slow = 0.2 * np.sin(np.arange(3000) / 100)
    found = misfit(noise() + slow, RUN, ALL)
    assert found.noise == pytest.approx(0.02, rel=0.1)
    assert found.times == pytest.approx(0.2 * np.sin(0.45 * np.pi) / 1.645 / 0.02, rel=0.1)
    left = noise()
    left[400:1000] += 0.5 + np.linspace(0, 1, 600) ** 2
    inliers = np.abs(left) < 0.1
    assert misfit(left, RUN, inliers).times > 10


def test_kinks_steps_between_runs_and_nothing_to_compare_are_no_misfit():
    left = noise()
    left[::50] += 1.0
    assert misfit(left, RUN, np.abs(left) < 0.1).times < 1.5
    left = noise(sigma=1e-3) + RUN
    assert misfit(left, RUN, ALL).noise == pytest.approx(1e-3, rel=0.1)
    assert np.isnan(misfit(np.zeros(10), np.zeros(10, dtype=int), ALL[:10]).times)
    assert np.isnan(misfit(noise()[:10], np.arange(10), ALL[:10]).times)
