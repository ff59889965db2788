import numpy as np
import pytest
from scipy.signal import lfilter

from estimation.statistics.serial_covariance import sum_covariance


def ar1(rng, correlation, count):
    return lfilter([1.0], [1.0, -correlation], rng.standard_normal(count + 500))[500:]


@pytest.mark.parametrize(("correlation", "tolerance"), [(0.0, 0.05), (0.5, 0.05), (0.9, 0.1), (0.97, 0.15)])
def test_sum_of_correlated_terms_is_as_uncertain_as_theory_says(correlation, tolerance):
    rng = np.random.default_rng(0)
    estimates = [sum_covariance(ar1(rng, correlation, 4000)[:, None]).matrix[0, 0] for _ in range(60)]
    assert np.mean(estimates) == pytest.approx(4000 / (1 - correlation) ** 2, rel=tolerance)


def test_two_columns_keep_their_covariance():
    rng = np.random.default_rng(1)
    mix = np.array([[1.0, 0.0], [0.8, 0.6]])
    found = np.mean(
        [sum_covariance(rng.standard_normal((2000, 2)) @ mix.T).matrix for _ in range(40)], axis=0
    )
    np.testing.assert_allclose(found / 2000, mix @ mix.T, atol=0.05)


def test_runs_are_independent_of_each_other():
    rng = np.random.default_rng(2)
    terms = ar1(rng, 0.9, 3000)[:, None]
    run = np.repeat([0, 1, 2], 1000)
    parts = sum(sum_covariance(terms[run == number]).matrix[0, 0] for number in range(3))
    assert sum_covariance(terms, run).matrix[0, 0] == pytest.approx(parts, rel=0.2)


def test_the_order_in_which_runs_are_stored_does_not_matter():
    rng = np.random.default_rng(3)
    terms, run = ar1(rng, 0.8, 900)[:, None], np.repeat([0, 1, 2], 300)
    order = np.concatenate([np.flatnonzero(run == number) for number in (2, 0, 1)])
    swapped = sum_covariance(terms[order], run[order]).matrix
    np.testing.assert_allclose(swapped, sum_covariance(terms, run).matrix, rtol=1e-9)


def test_effective_count_shrinks_with_correlation():
    rng = np.random.default_rng(4)
    white = sum_covariance(ar1(rng, 0.0, 5000)[:, None]).effective_count
    coloured = sum_covariance(ar1(rng, 0.9, 5000)[:, None]).effective_count
    assert white > 4000
    assert coloured == pytest.approx(5000 * 0.1 / 1.9, rel=0.5)


def test_terms_that_are_all_zero_have_no_uncertainty():
    assert not sum_covariance(np.zeros((50, 2))).matrix.any()
