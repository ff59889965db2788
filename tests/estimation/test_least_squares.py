import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear, nnls

from estimation.statistics.least_squares import solve, solve_within_bounds


def columns_and_effort(seed=0, count=200, gains=3):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((count, gains)), rng.standard_normal(count)


def test_agrees_with_the_orthogonal_solution():
    columns, effort = columns_and_effort()
    weights = np.random.default_rng(1).uniform(0.1, 3.0, len(effort))
    expected = np.linalg.lstsq(columns * weights[:, None], effort * weights, rcond=None)[0]
    np.testing.assert_allclose(solve(columns, effort, weights).gains, expected, rtol=1e-10)


@given(st.lists(st.floats(-9, 9), min_size=3, max_size=3))
def test_units_of_the_columns_do_not_matter(exponents):
    columns, effort = columns_and_effort()
    scale = 10.0 ** np.array(exponents)
    scaled = solve(columns * scale, effort)
    plain = solve(columns, effort)
    np.testing.assert_allclose(scaled.gains * scale, plain.gains, rtol=1e-8)
    assert scaled.condition_number == pytest.approx(plain.condition_number, rel=1e-6)


def test_nearly_dependent_columns_are_still_solved():
    columns, _ = columns_and_effort()
    columns[:, 2] = columns[:, 1] + 1e-8 * columns[:, 2]
    truth = np.array([1.0, 2.0, 3.0])
    found = solve(columns, columns @ truth)
    np.testing.assert_allclose(columns @ found.gains, columns @ truth, atol=1e-7)
    assert found.condition_number > 1e7


def test_a_silent_column_gets_no_gain_and_an_infinite_condition_number():
    columns, effort = columns_and_effort()
    columns[:, 1] = 0.0
    found = solve(columns, effort)
    assert found.gains[1] == 0.0
    assert np.isinf(found.condition_number)


@pytest.mark.parametrize("seed", range(20))
def test_nonnegative_gains_are_those_of_scipy(seed):
    """Columns that resemble each other: a gain that was zero may be positive beside the others' zeros."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((60, 8)) @ (np.eye(8) + 0.6 * rng.standard_normal((8, 8)))
    effort = columns @ rng.standard_normal(8) + rng.standard_normal(60)
    system, moment = columns.T @ columns, columns.T @ effort
    found = solve_within_bounds(system, moment, np.zeros(8), np.full(8, np.inf))
    np.testing.assert_allclose(found, nnls(columns, effort)[0], atol=1e-8)


@pytest.mark.parametrize("seed", range(20))
def test_gains_between_bounds_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((60, 6)) @ (np.eye(6) + 0.6 * rng.standard_normal((6, 6)))
    effort = columns @ rng.standard_normal(6) + rng.standard_normal(60)
    lower, upper = rng.uniform(-1.0, 0.0, 6), rng.uniform(0.1, 1.0, 6)
    found = solve_within_bounds(columns.T @ columns, columns.T @ effort, lower, upper)
    np.testing.assert_allclose(found, lsq_linear(columns, effort, (lower, upper), method="bvls").x, atol=1e-7)
