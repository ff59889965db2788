"""Robust weights, against their derivatives and scipy's minimum of the same loss."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import norm

from palpate.estimation.fit.irls import CUT, IrlsResult, absolute_loss_weights, cauchy_influence, irls
from palpate.estimation.statistics.noise import NoiseLevel

U = np.linspace(-8.0, 8.0, 3201)  # residuals in standard deviations
GAUSS = norm.pdf(U) * (U[1] - U[0])
T = np.linspace(0.0, 2.0, 400)


def settled_at(residuals, sigma=1.0):
    level = NoiseLevel(sigma, 0.0)
    return IrlsResult(
        np.zeros(1), np.ones((len(residuals), 1)), residuals, np.full(len(residuals), sigma), level
    )


def cauchy(u):
    weight, slope = cauchy_influence(u)
    return weight * u, slope


def biweight(u):
    return settled_at(2.0 * u, 2.0).influence


@pytest.mark.parametrize(("influence", "efficiency"), [(cauchy, 0.95), (biweight, 0.975)])
def test_influence_matches_its_slope_and_has_high_gaussian_efficiency(influence, efficiency):
    """Efficiency of an M-estimate: (E psi')^2 / E psi^2 (Huber, Robust Statistics (1981), ch. 3)."""
    psi, slope = influence(U)
    assert np.gradient(psi, U)[1:-1] == pytest.approx(slope[1:-1], abs=2e-3)
    assert psi == pytest.approx(-psi[::-1])
    assert slope[1600] == pytest.approx(1.0)
    assert np.sum(slope * GAUSS) ** 2 / np.sum(psi**2 * GAUSS) == pytest.approx(efficiency, abs=0.003)


def test_outliers_have_no_weight_and_absolute_loss_finds_the_median():
    found = settled_at(np.array([0.99, 1.0, -1.0]) * CUT)
    assert found.inside.tolist() == [True, False, False]
    assert (found.influence[0] != 0.0).tolist() == [True, False, False]
    values = np.random.default_rng(1).normal(size=101) ** 3
    middle = values.mean()
    for _ in range(200):
        share = absolute_loss_weights(values - middle)
        middle = np.sum(share * values) / np.sum(share)
    assert middle == pytest.approx(np.median(values), abs=0.02)
    far = np.array([1.0, -2.0, 300.0])
    assert absolute_loss_weights(far) * far**2 == pytest.approx(np.abs(far))
    assert np.isfinite(1e200 * absolute_loss_weights(np.zeros(3))).all()


def decay(values):
    """A curve with its slopes by size and rate."""
    size, rate = values
    wave = np.exp(-rate * T)
    return size * wave, np.column_stack([wave, -size * T * wave])


@pytest.mark.parametrize("known", [NoiseLevel(0.1, 0.0), NoiseLevel(0.05, 0.05), None])
@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_steps_minimize_tukey_s_loss(known, wrong):
    rng = np.random.default_rng(2)
    level = known or NoiseLevel(0.1, 0.0)
    clean = decay([3.0, 1.2])[0]
    effort = clean + level.sigma(clean) * rng.normal(size=len(T)) + 5.0 * (rng.random(len(T)) < wrong)
    found = irls(decay, effort, np.array([3.2, 1.3]), known)

    def cost(z):
        """Of the squared residual: rho and its two derivatives, in units of the cut."""
        inside = np.maximum(1.0 - z, 0.0)
        return np.array([(1.0 - inside**3) / 3.0, inside**2, -2.0 * inside])

    best = least_squares(
        lambda values: (effort - decay(values)[0]) / (CUT * found.sigma), [3.0, 1.2], loss=cost
    )
    error = np.sqrt(np.diag(np.linalg.inv(found.slopes.T @ (found.slopes / found.sigma[:, None] ** 2))))
    assert np.abs(found.values - best.x).max() < 0.02 * error.min()
    assert np.abs(found.values - [3.0, 1.2]).max() < 4.0 * error.max()
    assert found.residuals == pytest.approx(effort - decay(found.values)[0])
    assert found.sigma == pytest.approx(level.sigma(clean), rel=0.2)


def test_noise_is_that_of_most_samples_or_of_all_without_inliers():
    rng = np.random.default_rng(3)
    flat = lambda values: (np.full(400, values[0]), np.ones((400, 1)))  # noqa: E731
    some = np.where(np.arange(400) < 320, 0.1 * rng.normal(size=400), 30.0 + rng.normal(size=400))
    assert irls(flat, some, np.zeros(1)).level.floor == pytest.approx(0.1, rel=0.15)
    few = np.where(np.arange(400) < 16, 1e-3 * rng.normal(size=400), 30.0 + rng.normal(size=400))
    assert irls(flat, few, np.zeros(1)).level.floor > 0.01  # one in 25 samples does not tell the noise
    far = irls(flat, rng.normal(size=400) + 1e3, np.zeros(1))
    assert np.isfinite(far.values).all()
    assert (far.sigma > 0.0).all()
