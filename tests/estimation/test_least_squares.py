import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.statistics.least_squares import solve


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
