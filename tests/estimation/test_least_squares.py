"""Bounded least squares, its covariance under correlated noise, and what is said of uncertainty."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from palpate.estimation.assessment import assess_parameters
from palpate.estimation.estimate import Determined, Identifiability
from palpate.estimation.statistics.least_squares import condition_of_gram, solve, solve_within_bounds
from palpate.estimation.statistics.noise import sum_covariance
from palpate.estimation.statistics.uncertainty import sandwich
from tests.estimation.problems import motion


def columns_and_effort(seed=0, count=200, gains=3):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((count, gains)), rng.standard_normal(count)


def test_solution_agrees_with_the_orthogonal_one():
    columns, effort = columns_and_effort()
    weights = np.random.default_rng(1).uniform(0.1, 3.0, len(effort))
    expected = np.linalg.lstsq(columns * weights[:, None], effort * weights, rcond=None)[0]
    np.testing.assert_allclose(solve(columns, effort, weights), expected, rtol=1e-10)


@given(st.lists(st.floats(-9, 9), min_size=3, max_size=3))
def test_units_of_the_columns_do_not_matter(exponents):
    columns, effort = columns_and_effort()
    scale = 10.0 ** np.array(exponents)
    scaled = solve(columns * scale, effort)
    np.testing.assert_allclose(scaled * scale, solve(columns, effort), rtol=1e-8)


def test_nearly_dependent_columns_are_solved_and_a_zero_one_gets_no_gain():
    columns, _ = columns_and_effort()
    columns[:, 2] = columns[:, 1] + 1e-8 * columns[:, 2]
    truth = np.array([1.0, 2.0, 3.0])
    found = solve(columns, columns @ truth)
    np.testing.assert_allclose(columns @ found, columns @ truth, atol=1e-7)
    assert condition_of_gram(columns.T @ columns) > 1e7
    columns, effort = columns_and_effort()
    columns[:, 1] = 0.0
    found = solve(columns, effort)
    assert found[1] == 0.0
    assert np.isinf(condition_of_gram(columns.T @ columns))


@pytest.mark.parametrize("seed", range(12))
def test_gains_within_bounds_match_scipy(seed):
    """Columns that resemble each other: a gain that was zero may be positive beside the others' zeros."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((60, 8)) @ (np.eye(8) + 0.6 * rng.standard_normal((8, 8)))
    effort = columns @ rng.standard_normal(8) + rng.standard_normal(60)
    lower, upper = rng.uniform(-1.0, 0.0, 8), rng.uniform(0.1, 1.0, 8)
    if seed % 2:  # nonnegative
        lower, upper = np.zeros(8), np.full(8, np.inf)
    found = solve_within_bounds(columns.T @ columns, columns.T @ effort, lower, upper)
    np.testing.assert_allclose(found, lsq_linear(columns, effort, (lower, upper), method="bvls").x, atol=1e-7)


def ar1(rng, correlation, count):
    return lfilter([1.0], [1.0, -correlation], rng.standard_normal(count + 500))[500:]


@pytest.mark.parametrize(("correlation", "tolerance"), [(0.0, 0.05), (0.5, 0.05), (0.9, 0.1), (0.97, 0.15)])
def test_variance_of_a_correlated_sum_matches_theory(correlation, tolerance):
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


def test_runs_are_independent_in_any_order():
    rng = np.random.default_rng(2)
    terms = ar1(rng, 0.9, 3000)[:, None]
    run = np.repeat([0, 1, 2], 1000)
    parts = sum(sum_covariance(terms[run == number]).matrix[0, 0] for number in range(3))
    assert sum_covariance(terms, run).matrix[0, 0] == pytest.approx(parts, rel=0.2)
    rng = np.random.default_rng(3)
    terms, run = ar1(rng, 0.8, 900)[:, None], np.repeat([0, 1, 2], 300)
    order = np.concatenate([np.flatnonzero(run == number) for number in (2, 0, 1)])
    swapped = sum_covariance(terms[order], run[order]).matrix
    np.testing.assert_allclose(swapped, sum_covariance(terms, run).matrix, rtol=1e-9)


def test_correlation_shrinks_the_effective_count_and_zeros_have_no_error():
    rng = np.random.default_rng(4)
    white = sum_covariance(ar1(rng, 0.0, 5000)[:, None]).effective_count
    coloured = sum_covariance(ar1(rng, 0.9, 5000)[:, None]).effective_count
    assert white > 4000
    assert coloured == pytest.approx(5000 * 0.1 / 1.9, rel=0.5)
    assert not sum_covariance(np.zeros((50, 2))).matrix.any()


NAMES = ("k", "c")


def assessed(values, noise, columns=None, gain_count=2):
    columns = motion()[0] if columns is None else columns
    effort = columns @ np.array(values)
    residuals = noise * np.random.default_rng(0).standard_normal(len(effort))
    covariance = sandwich(columns, residuals, np.ones(len(effort)))
    return assess_parameters(NAMES, np.array(values), columns, effort, covariance, gain_count=gain_count)


def test_uncorrelated_even_noise_gives_the_textbook_errors():
    columns = motion(9000)[0]
    textbook = 0.02 * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    rng = np.random.default_rng(1)
    found = [sandwich(columns, 0.02 * rng.standard_normal(9000), np.ones(9000)) for _ in range(20)]
    np.testing.assert_allclose(np.mean([each.std_err for each in found], axis=0), textbook, rtol=0.04)
    assert np.median([each.degrees_of_freedom for each in found]) > 1000


def test_small_sample_residuals_are_corrected():
    """Five gains of twenty samples take a quarter of the noise's energy with them."""
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(20, 5))
    hat = columns @ np.linalg.pinv(columns)
    draws = [noise - hat @ noise for noise in rng.normal(size=(500, 20))]
    variance = np.mean([sandwich(columns, left, np.ones(20)).std_err ** 2 for left in draws], axis=0)
    truth = np.diag(np.linalg.inv(columns.T @ columns))
    assert np.mean(variance / truth) == pytest.approx(1.0, abs=0.12)


def test_runs_are_no_neighbors_across_their_ends():
    """The order of runs says nothing; scores of neighbouring samples of one run go together."""
    rng = np.random.default_rng(3)
    run = np.repeat(np.arange(30), 6)
    columns = np.column_stack([np.ones(180), rng.normal(size=180)])
    residuals = np.repeat(rng.normal(size=30), 6) + 0.3 * rng.normal(size=180)
    residuals -= columns @ np.linalg.lstsq(columns, residuals, rcond=None)[0]
    order = np.concatenate([np.flatnonzero(run == number) for number in np.argsort(residuals[::6])])
    plain, ordered = (
        sandwich(columns[rows], residuals[rows], np.ones(180), run[rows]).std_err
        for rows in (np.arange(180), order)
    )
    np.testing.assert_allclose(ordered, plain)


def test_errors_have_the_parameters_units():
    columns = motion()[0]
    residuals = np.random.default_rng(2).standard_normal(len(columns))
    scale = np.array([1e6, 1e-6])
    plain = sandwich(columns, residuals, np.ones(len(columns)))
    scaled = sandwich(columns * scale, residuals, np.ones(len(columns)))
    np.testing.assert_allclose(scaled.std_err * scale, plain.std_err, rtol=1e-6)


@pytest.mark.parametrize(
    ("values", "noise", "grade", "determined", "words"),
    [
        ((500.0, 20.0), 0.02, Identifiability.GOOD, "yes yes", "determine every parameter"),
        ((500.0, 0.0), 0.0, Identifiability.GOOD, "yes yes", "determine every parameter"),
        ((500.0, 0.01), 0.02, Identifiability.WEAK, "yes no", "^c: not significantly .*, with little"),
        ((500.0, 0.08), 0.02, Identifiability.WEAK, "yes roughly", "^c: known only roughly, with little"),
        ((500.0, 12.0), 3.0, Identifiability.WEAK, "yes roughly", "^c: known only roughly; excite it more"),
        ((500.0, 4.0), 3.0, Identifiability.WEAK, "yes no", "^c: known only roughly; excite it more"),
        ((500.0, 20.0), 2000.0, Identifiability.NONE, "no no", "cannot be determined"),
    ],
)
def test_identifiability_is_reported(values, noise, grade, determined, words):
    found = assessed(values, noise)
    assert found.identifiability is grade
    assert " ".join(found.determined) == determined
    assert re.search(words, found.note)


def test_correlated_parameters_are_a_pair_and_one_near_zero_may_be_determined():
    assert assessed((500.0, 0.01), 0.02, gain_count=1).determined == (Determined.YES, Determined.YES)
    depth = motion()[0][:, 0]
    rng = np.random.default_rng(3)
    columns = np.column_stack([depth, 10 * depth + 0.005 * rng.standard_normal(len(depth))])
    found = assessed((300.0, 10.0), 0.4, columns)
    assert found.identifiability is not Identifiability.GOOD
    assert "is correlated with" in found.note
    assert "vary speed and position" in found.note  # of joints as well, which have no depth
    columns = motion()[0] * [1.0, 0.0]
    found = sandwich(columns, np.ones(len(columns)), np.ones(len(columns)))
    assert np.isnan(found.std_err).all()
    assert np.isnan(found.intervals(np.zeros(2))).all()


def test_few_effective_samples_widen_the_interval():
    found = sandwich(np.ones((40, 1)), np.sin(np.linspace(0, 3, 40)), np.ones(40))
    low, high = found.intervals(np.zeros(1))[0]
    assert high - low > 2 * 1.96 * found.std_err[0]
    assert found.degrees_of_freedom == pytest.approx(1.0, abs=8)
