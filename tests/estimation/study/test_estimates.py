"""Estimates of a study: which samples of a contact they use."""

import numpy as np
import pytest

from palpate.estimation.study.estimates import estimate_with
from tests.estimation.presses import NOISE_N, K, channel

DAMPING = 20.0


def shaken(seed):
    """Two runs so quick that the object lets go of the tip on its way out, a fifth of the time."""
    rng, time_s = np.random.default_rng(seed), np.tile(np.arange(0.0, 4.0, 0.002), 2)
    run = np.repeat([0, 1], len(time_s) // 2)
    rate = np.where(run == 0, 6.0, 9.0)
    x = 0.004 * np.sin(rate * time_s)
    v = 0.004 * rate * np.cos(rate * time_s)
    force = np.where(x > 0, np.maximum(K * x + DAMPING * v, 0.0), 0.0)
    return channel(force + rng.normal(0.0, NOISE_N, len(x)), time_s, x, v, run), force


@pytest.mark.parametrize("name", ["lsq", "robust"])
def test_samples_after_the_object_lets_go_are_not_fitted(name):
    errors = []
    for seed in range(10):
        data, force = shaken(seed)
        estimates = estimate_with(data, "kelvin_voigt", [name])
        (estimate,) = estimates.estimates
        lifted = (data.position > 0) & (force == 0)
        assert np.count_nonzero(estimates.rows & lifted) < 0.1 * np.count_nonzero(lifted)
        damping = estimate["damping.c"]
        errors.append((damping.value - DAMPING) / damping.std_err)
    assert abs(np.mean(errors)) < 1.0  # without the selection: -3 and more
    assert np.sqrt(np.mean(np.square(errors))) < 1.6
