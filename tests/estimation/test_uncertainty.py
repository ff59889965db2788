import re

import numpy as np
import pytest

from estimation.estimate import Determined, Identifiability
from estimation.statistics.uncertainty import assess_parameters, sandwich
from tests.estimation.problems import motion

NAMES = ("k", "c")


def assessed(values, noise, columns=None, gain_count=2):
    columns = motion()[0] if columns is None else columns
    effort = columns @ np.array(values)
    residuals = noise * np.random.default_rng(0).standard_normal(len(effort))
    covariance = sandwich(columns, residuals, np.ones(len(effort)))
    return assess_parameters(NAMES, np.array(values), columns, effort, covariance, gain_count=gain_count)


def test_even_uncorrelated_noise_gives_the_textbook_errors():
    columns = motion(9000)[0]
    textbook = 0.02 * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    rng = np.random.default_rng(1)
    found = [sandwich(columns, 0.02 * rng.standard_normal(9000), np.ones(9000)) for _ in range(20)]
    np.testing.assert_allclose(np.mean([each.std_err for each in found], axis=0), textbook, rtol=0.04)
    assert np.median([each.degrees_of_freedom for each in found]) > 1000


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
        ((500.0, 0.01), 0.02, Identifiability.WEAK, "yes no", "^c: cannot be told from zero, of little"),
        ((500.0, 0.08), 0.02, Identifiability.WEAK, "yes roughly", "^c: known only roughly, of little"),
        ((500.0, 12.0), 3.0, Identifiability.WEAK, "yes roughly", "^c: known only roughly; excite it more"),
        ((500.0, 4.0), 3.0, Identifiability.WEAK, "yes no", "^c: known only roughly; excite it more"),
        ((500.0, 20.0), 2000.0, Identifiability.NONE, "no no", "could be anything"),
    ],
)
def test_how_far_data_determine_parameters_is_said(values, noise, grade, determined, words):
    found = assessed(values, noise)
    assert found.identifiability is grade
    assert " ".join(found.determined) == determined
    assert re.search(words, found.note)


def test_a_place_near_zero_is_determined_if_its_error_does_nothing():
    assert assessed((500.0, 0.01), 0.02, gain_count=1).determined == (Determined.YES, Determined.YES)


def test_parameters_that_change_together_are_named_as_a_pair():
    depth = motion()[0][:, 0]
    rng = np.random.default_rng(3)
    columns = np.column_stack([depth, 10 * depth + 0.005 * rng.standard_normal(len(depth))])
    found = assessed((300.0, 10.0), 0.4, columns)
    assert found.identifiability is not Identifiability.GOOD
    assert "changes together with" in found.note or "could be anything" in found.note


def test_a_column_of_zeros_has_no_covariance():
    columns = motion()[0] * [1.0, 0.0]
    found = sandwich(columns, np.ones(len(columns)), np.ones(len(columns)))
    assert np.isnan(found.std_err).all()
    assert np.isnan(found.intervals(np.zeros(2))).all()


def test_few_effective_samples_widen_the_interval():
    columns = np.ones((40, 1))
    slow = np.sin(np.linspace(0, 3, 40))
    found = sandwich(columns, slow, np.ones(40))
    low, high = found.intervals(np.zeros(1))[0]
    assert high - low > 2 * 1.96 * found.std_err[0]
    assert found.degrees_of_freedom == pytest.approx(1.0, abs=8)
