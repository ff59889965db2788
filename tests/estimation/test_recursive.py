import numpy as np
import pytest

from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.estimators.recursive import Ewrls, Rls, Sprls
from palpate.robot_io.errors import InputError
from tests.estimation.problems import TRUTH, motion, problem, values

ONLINE = pytest.mark.parametrize("estimator", [Rls(), Ewrls(), Sprls()], ids=lambda e: e.name)


def feed(estimator, columns, effort, *, afresh=True):
    estimator.start(columns.shape[1]) if afresh else None
    return np.array([estimator.update(row, float(value)) for row, value in zip(columns, effort, strict=True)])


def test_rls_is_least_squares_with_a_prior_and_ewrls_weights_by_age():
    regression = problem(np.random.default_rng(0))
    gains = feed(Rls(variance=1e6), regression.columns, regression.effort)[-1]
    normal = regression.columns.T @ regression.columns + np.eye(2) / 1e6
    np.testing.assert_allclose(
        gains, np.linalg.solve(normal, regression.columns.T @ regression.effort), rtol=1e-6
    )
    regression = problem(np.random.default_rng(1))
    gains = feed(Ewrls(forgetting=0.99), regression.columns, regression.effort)[-1]
    weighted = regression.columns * (0.99 ** np.arange(len(regression.effort))[::-1])[:, None]
    expected = np.linalg.solve(weighted.T @ regression.columns, weighted.T @ regression.effort)
    np.testing.assert_allclose(gains, expected, rtol=1e-5)


@pytest.mark.parametrize("estimator", [Ewrls(forgetting=1.0), Sprls(beta=0.0, gamma=0.0)])
def test_estimator_reduces_to_rls(estimator):
    regression = problem(np.random.default_rng(2))
    plain = feed(Rls(), regression.columns, regression.effort)
    np.testing.assert_allclose(feed(estimator, regression.columns, regression.effort), plain)


def test_ewrls_does_not_run_away_at_rest():
    columns = np.tile([0.005, 0.0], (20_000, 1))
    rng = np.random.default_rng(3)
    estimator = Ewrls()
    feed(estimator, columns, 2.5 + 0.02 * rng.standard_normal(len(columns)))
    moving = motion()[0]
    after = feed(estimator, moving, moving @ TRUTH, afresh=False)
    assert np.all(np.abs(after) < 1e5)
    np.testing.assert_allclose(after[-1], TRUTH, rtol=0.01)


def test_sprls_perturbs_only_for_a_large_error():
    """One gain by hand, after Park and Jun: P' = P - P^2/(1 + P) + beta nint(gamma e^2), from P = 1."""
    row = np.array([1.0])
    for error, expected_gain in ((0.70, 0.5 / 1.5), (0.72, 20.5 / 21.5), (2.0, 80.5 / 81.5)):
        estimator = Sprls(beta=20.0, gamma=1.0, variance=1.0)
        estimator.start(1)
        before = estimator.update(row, error)  # nint(0.49) = 0, nint(0.5184) = 1, nint(4) = 4
        after = estimator.update(row, 10.0)
        assert (after - before) / (10.0 - before) == pytest.approx(expected_gain)


def test_sprls_follows_a_sudden_change_sooner_than_rls():
    columns = motion(1800)[0]
    effort = (columns @ TRUTH) * np.where(np.arange(1800) < 900, 1.0, 3.0)
    rls, sprls = (feed(estimator, columns, effort)[950] for estimator in (Rls(), Sprls()))
    assert abs(sprls[0] - 1500.0) < 0.2 * abs(rls[0] - 1500.0)


def test_sprls_is_unsteady_in_noise_as_in_the_paper():
    noise = {"noise": 0.0, "share": 0.3, "count": 900}
    problems = [problem(np.random.default_rng(seed), **noise) for seed in range(10)]
    tight, loose = (
        np.std([values(each.fit(one, rng=None)) for one in problems], axis=0)
        for each in (Sprls(0.0, 0.0), Sprls(20.0, 1.0))
    )
    assert np.all(loose > 1.5 * tight)


@ONLINE
def test_fit_matches_the_loop_and_gains_are_not_overwritten(estimator):
    regression = problem(np.random.default_rng(5), count=300)
    found = estimator.fit(regression, rng=np.random.default_rng(0))
    live = feed(type(estimator)(), regression.columns, regression.effort)[-1]
    np.testing.assert_allclose(values(found), live, rtol=1e-4, atol=1e-3)
    estimator.start(2)
    first = estimator.update(np.array([0.01, 0.1]), 5.0)
    kept = first.copy()
    estimator.update(np.array([0.02, 0.1]), 9.0)
    np.testing.assert_array_equal(first, kept)
    regression = problem(np.random.default_rng(6))
    scale = np.array([1e-6, 1e-6])
    small = type(regression)(
        regression.columns * scale, regression.effort, regression.names, regression.units
    )
    found = values(estimator.fit(small, rng=np.random.default_rng(0)))
    np.testing.assert_allclose(found * scale, TRUTH, rtol=0.01)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("rls", {"variance": 0.0}),
        ("ewrls", {"forgetting": 0.0}),
        ("ewrls", {"forgetting": 1.1}),
        ("sprls", {"beta": -1.0}),
        ("sprls", {"gamma": -1.0}),
        ("cusum_rls", {"limit": 0.0}),
        ("preemptive_ransac", {"threshold": -1.0}),
        ("ransac", {"threshold": 0.0}),
        ("ransac", {"threshold": float("nan")}),
        ("ransac", {"trials": 0}),
        ("ransac", {"subset": 0}),
    ],
)
def test_invalid_settings_are_refused(name, settings):
    with pytest.raises(InputError, match=name):
        ESTIMATORS[name](**settings)
