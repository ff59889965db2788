import numpy as np
import pytest

from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.estimators.batch import Lsq, Robust, Weighted
from palpate.estimation.model import Regression
from palpate.estimation.statistics.noise import fit_noise_level
from tests.estimation.problems import NAMES, TRUTH, UNITS, covered, motion, problem, values


def fit(estimator, regression, seed=0):
    return estimator.fit(regression, rng=np.random.default_rng(seed))


def scatter(estimator, draws, **noise):
    errors = [
        values(fit(estimator, problem(np.random.default_rng(s), **noise))) - TRUTH for s in range(draws)
    ]
    return np.sqrt(np.mean(np.square(errors), axis=0))


def cramer_rao(sigma):
    columns = motion()[0] / sigma[:, None]
    return np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))


@pytest.mark.parametrize("outliers", [0.1, 0.3, 0.4])
def test_one_sided_outliers_hardly_move_the_estimate(outliers):
    assert np.all(scatter(Robust(), 25, outliers=outliers) < 2.2 * cramer_rao(np.full(900, 0.02)))


def test_outliers_are_no_inliers_and_clean_data_lose_little():
    regression = problem(np.random.default_rng(1), outliers=0.2)
    found = fit(Robust(), regression)
    wrong = regression.effort - regression.columns @ TRUTH > 0.3
    assert not found.inliers[wrong].any()
    assert found.inliers[~wrong].mean() > 0.98
    assert np.all(scatter(Robust(), 80) < 1.2 * cramer_rao(np.full(900, 0.02)))


@pytest.mark.parametrize("estimator", [Robust(), Weighted()])
def test_estimate_reaches_the_bound_for_force_dependent_noise(estimator):
    sigma = 0.1 * (motion()[0] @ TRUTH)
    assert np.all(scatter(estimator, 80, noise=0.0, share=0.1) < 1.25 * cramer_rao(sigma))


def test_intervals_hold_with_outliers_and_uneven_noise():
    noise = {"noise": 0.01, "share": 0.05, "outliers": 0.15}
    rates = [covered(fit(Robust(), problem(np.random.default_rng(s), **noise))) for s in range(80)]
    assert np.all(np.mean(rates, axis=0) > 0.86)


def test_perfectly_fitted_rest_does_not_outvote_the_motion():
    """Half of the samples rest where the model is exact; in the others it is a little wrong everywhere."""
    columns, run = motion(1800)
    columns = columns.copy()
    columns[900:] = [0.004, 0.0]
    rng = np.random.default_rng(5)
    bent = columns @ TRUTH + 0.15 * np.sin(600 * columns[:, 0]) + 0.03 * rng.standard_normal(1800)
    bent[900:] = 1.0 + 0.0005 * rng.standard_normal(900)
    regression = Regression(columns, bent, NAMES, UNITS, run=run)
    plain, robust = fit(Lsq(), regression), fit(Robust(), regression)
    assert robust.inliers.mean() > 0.9
    assert robust.rmse < 1.1 * plain.rmse


def test_few_samples_in_motion_are_no_outliers_beside_a_long_hold():
    """A damping that fits none of them leaves the median residual as it is."""
    truth, depth_m, t = np.array([7100.0, 100.0]), 0.0014, np.linspace(0.0, 1.0, 40)
    loading = np.column_stack([depth_m * t, 0.13 * (1.0 - t) + 0.005])
    unloading = np.column_stack([depth_m * (1.0 - 0.7 * t), -0.05 * np.sqrt(t)])
    for seed in range(12):
        rng = np.random.default_rng(seed)
        hold = np.column_stack([np.full(1000, depth_m), 1e-4 * rng.standard_normal(1000)])
        columns = np.tile(np.vstack([loading, hold, unloading]), (3, 1))
        noise_n = np.where(np.abs(columns[:, 1]) > 1e-3, 0.08, 0.025)  # with errors of the motion
        effort = columns @ truth + noise_n * rng.standard_normal(len(columns))
        run = np.repeat([0, 1, 2], len(columns) // 3)
        found = fit(Robust(), Regression(columns, effort, NAMES, UNITS, run=run), seed)
        assert found.inliers.mean() > 0.98
        np.testing.assert_allclose(values(found), truth, rtol=0.01)


def test_noise_level_finds_floor_and_share_and_even_noise_has_none():
    rng = np.random.default_rng(3)
    force = rng.uniform(0.0, 10.0, 8000)
    level = fit_noise_level(np.hypot(0.05, 0.03 * force) * rng.standard_normal(8000), force)
    assert level.floor == pytest.approx(0.05, rel=0.15)
    assert level.share == pytest.approx(0.03, rel=0.1)
    rng = np.random.default_rng(4)
    level = fit_noise_level(0.05 * rng.standard_normal(8000), rng.uniform(0.0, 10.0, 8000))
    assert level.floor == pytest.approx(0.05, rel=0.1)
    assert level.share < 0.003


@pytest.mark.parametrize("estimator", ["robust", "weighted", "ransac", "lsq", "rls"])
def test_noiseless_data_are_estimated(estimator):
    time_s = np.arange(400) * 0.002
    columns = np.column_stack([np.arange(400) % 7, np.sin(9 * time_s)]) * 1.0
    exact = Regression(columns, columns @ [3.0, 0.0], ("k", "c"), ("N/m", "N s/m"))
    found = ESTIMATORS[estimator]().fit(exact, rng=np.random.default_rng(0))
    assert found["k"].value == pytest.approx(3.0)
    assert found["c"].value == pytest.approx(0.0, abs=1e-9)
