import numpy as np
import pytest

from palpate.estimation.estimators.ransac import Ransac
from palpate.estimation.model import Regression
from palpate.estimation.statistics.least_squares import solve_subsets
from palpate.estimation.statistics.uncertainty import cramer_rao
from palpate.robot_io.errors import InputError
from tests.estimation.problems import NAMES, TRUTH, UNITS, motion, problem, std_errs, values


def fit(regression, seed=0, **settings):
    return Ransac(**settings).fit(regression, rng=np.random.default_rng(seed))


@pytest.mark.parametrize(("noise", "outliers", "most"), [(0.02, 0.0, 1.3), (0.2, 0.0, 1.3), (0.02, 0.3, 1.7)])
def test_threshold_follows_the_noise_near_the_cramer_rao_bound(noise, outliers, most):
    problems = [problem(np.random.default_rng(seed), noise=noise, outliers=outliers) for seed in range(40)]
    bound = cramer_rao(problems[0].columns, np.full(len(problems[0].effort), noise))
    found = [fit(each, seed) for seed, each in enumerate(problems)]
    errors = np.sqrt(np.mean(np.square([values(each) - TRUTH for each in found]), axis=0))
    assert np.all(errors < most * bound)
    assert found[0].details["threshold"] == pytest.approx(2.5 * noise, rel=0.2)


@pytest.mark.parametrize("outliers", [0.1, 0.3, 0.5])
def test_outliers_do_not_move_the_estimate(outliers):
    found = fit(problem(np.random.default_rng(1), noise=0.003, outliers=outliers))
    np.testing.assert_allclose(values(found), TRUTH, rtol=0.005)
    assert found.inliers.mean() == pytest.approx(1 - outliers, abs=0.06)
    assert found.details["threshold"] == pytest.approx(2.5 * 0.003, rel=0.2)
    assert found.details["inlier_share"] == found.inliers.mean()


def test_inliers_agree_with_scikit_learn():
    from sklearn.linear_model import LinearRegression, RANSACRegressor  # slow to import

    regression = problem(np.random.default_rng(2), noise=0.003, outliers=0.3)
    other = RANSACRegressor(
        LinearRegression(fit_intercept=False),
        min_samples=5,
        residual_threshold=0.01,
        max_trials=300,
        random_state=0,
    ).fit(regression.columns, regression.effort)
    assert np.mean(fit(regression, threshold=0.01).inliers == other.inlier_mask_) > 0.99


@pytest.mark.parametrize(
    ("noise", "share", "threshold"),
    [(0.005, 0.0, 0.01), (0.08, 0.0, 0.01), (0.0, 0.1, 0.01), (0.08, 0.0, None), (0.0, 0.1, None)],
)
def test_stated_errors_follow_the_scatter_far_above_the_threshold(noise, share, threshold):
    problems = (problem(np.random.default_rng(seed), noise=noise, share=share) for seed in range(50))
    found = [fit(each, threshold=threshold) for each in problems]
    scatter = np.std([values(each) for each in found], axis=0)
    stated = np.median([std_errs(each) for each in found], axis=0)
    assert np.all(stated > 0.6 * scatter)
    assert np.all(stated < 3.0 * scatter)


def test_degenerate_subsets_are_skipped_and_samples_are_unique():
    columns, run = motion()
    columns = columns.copy()
    columns[:450] = [0.001, 0.01]  # standing still: five of these determine one number only
    found = fit(Regression(columns, columns @ TRUTH, NAMES, UNITS, run=run), trials=500)
    np.testing.assert_allclose(values(found), TRUTH, rtol=1e-6)
    assert 1 <= found.details["skipped_subsets"] < 100
    columns, effort = np.eye(4), np.arange(4.0)
    solved = solve_subsets(columns, effort, 4, 50, np.random.default_rng(0))
    np.testing.assert_allclose(solved, np.tile(effort, (50, 1)))


def test_ransac_failure_states_a_remedy():
    regression = problem(np.random.default_rng(5), noise=0.1)
    with pytest.raises(InputError, match=r"agree within 1e-09; raise the threshold .* or use 'robust'"):
        fit(regression, threshold=1e-9)
    regression = problem(np.random.default_rng(6), count=9)
    with pytest.raises(InputError, match="subsets of 50 samples: the size must be at least 2"):
        fit(regression, subset=50)
