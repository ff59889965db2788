"""One form for all registered estimators."""

import numpy as np
import pytest

from palpate.estimation.estimate import Identifiability, rounded
from palpate.estimation.estimator import Estimator, OnlineEstimator
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.model import Regression
from palpate.robot_io.errors import InputError
from tests.estimation.problems import NAMES, TRUTH, UNITS, covered, motion, problem, std_errs, values

EVERY = pytest.mark.parametrize("name", list(ESTIMATORS))
GENTLE_NOISE = 0.002  # N; well within the paper's threshold


def fit(name, regression, seed=0):
    return ESTIMATORS[name]().fit(regression, rng=np.random.default_rng(seed))


@EVERY
def test_estimator_has_metadata_and_recovers_the_truth(name):
    estimator = ESTIMATORS[name]
    assert issubclass(estimator, Estimator)
    assert estimator.name == name
    assert "Source: " in estimator.__doc__
    found = fit(name, problem(np.random.default_rng(1), noise=GENTLE_NOISE))
    np.testing.assert_allclose(values(found), TRUTH, rtol=0.01)
    assert found.identifiability is Identifiability.GOOD
    assert [p.name for p in found.parameters] == list(NAMES)
    assert [p.unit for p in found.parameters] == list(UNITS)


@EVERY
def test_errors_and_intervals_match_the_scatter(name):
    draws = 20 if issubclass(ESTIMATORS[name], OnlineEstimator) else 40
    found = [fit(name, problem(np.random.default_rng(seed), noise=GENTLE_NOISE)) for seed in range(draws)]
    assert np.mean([covered(each) for each in found]) > 0.85
    scatter = np.std([values(each) for each in found], axis=0)
    stated = np.median([std_errs(each) for each in found], axis=0)
    assert np.all(stated > 0.6 * scatter)
    assert np.all(stated < 2.0 * scatter)


@EVERY
def test_equal_seed_gives_equal_and_consistent_estimates(name):
    regression = problem(np.random.default_rng(2))
    before = regression.columns.copy(), regression.effort.copy()
    first, second = fit(name, regression, seed=7), fit(name, regression, seed=7)
    np.testing.assert_array_equal(values(first), values(second))
    np.testing.assert_array_equal(before[0], regression.columns)
    np.testing.assert_array_equal(before[1], regression.effort)
    regression = problem(np.random.default_rng(3), noise=GENTLE_NOISE)
    found = fit(name, regression)
    expected = regression.effort - regression.columns @ values(found)
    np.testing.assert_allclose(found.residuals, expected, atol=1e-12)
    assert found.inliers.shape == expected.shape
    assert found.inliers.mean() > 0.9
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), std_errs(found))


@EVERY
def test_unexcited_and_correlated_parameters_are_reported(name):
    columns, run = motion()
    columns = columns.copy()
    columns[:, 1] = 0.0
    silent = Regression(columns, columns @ TRUTH, NAMES, UNITS, run=run)
    depth = motion()[0][:, 0]
    rng = np.random.default_rng(4)
    columns = np.column_stack([depth, 10.0 * depth])
    twins = Regression(columns, 500.0 * depth + 0.001 * rng.standard_normal(len(depth)), NAMES, UNITS)
    for regression, words in ((silent, "the motion does not excite c at all"), (twins, "")):
        try:
            found = fit(name, regression)
        except InputError as error:
            assert "excite" in str(error)  # noqa: PT017, an estimator may refuse instead
        else:
            assert found.identifiability is Identifiability.NONE
            assert words in found.note


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"effort": np.zeros(9)}, r"columns \(10, 2\), effort \(9,\)"),
        ({"names": ("k",)}, r"names \('k',\)"),
        ({"units": ("N/m",)}, "columns"),
        ({"run": np.zeros(9, dtype=np.int64)}, r"run has shape \(9,\), expected \(10,\)"),
    ],
)
def test_regression_refuses_shapes_that_do_not_match(change, words):
    with pytest.raises(InputError, match=f"regression: .*{words}"):
        Regression(
            **{"columns": np.ones((10, 2)), "effort": np.zeros(10), "names": NAMES, "units": UNITS} | change
        )


@EVERY
def test_correlated_noise_widens_the_intervals(name):
    white = fit(name, problem(np.random.default_rng(5), noise=0.004))
    coloured = fit(name, problem(np.random.default_rng(5), noise=0.004, correlation=0.95))
    assert np.all(std_errs(coloured) > 1.5 * std_errs(white))


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        *((1234.5, 3, "1230"), (-187_654.0, 3, "-188000"), (999_999.0, 3, "1000000"), (2.5e7, 3, "2.50e+07")),
        *((0.00012345, 4, "0.0001234"), (123.0, 2, "120")),
    ],
)
def test_value_below_a_million_has_no_exponent(value, digits, text):
    assert rounded(value, digits) == text
