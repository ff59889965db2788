"""Fits on what flexible columns cannot explain, against joint least squares (Frisch and Waugh 1933)."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.fit.nuisance import nuisance_of
from tests.estimation.fit.test_fit_problem import COLUMNS, COUNT, TARGET, problem

RNG = np.random.default_rng(9)
FLEXIBLE = RNG.normal(size=(COUNT, 4)) + COLUMNS[:, :1]  # not orthogonal to what is fitted
PER_RUN = np.column_stack([np.ones(COUNT), RNG.normal(size=COUNT) + COLUMNS[:, 0]])
NONE = np.empty((COUNT, 0))


@pytest.mark.parametrize("per_run", [NONE, PER_RUN])
@pytest.mark.parametrize("flexible", [NONE, FLEXIBLE, np.column_stack([FLEXIBLE, FLEXIBLE.sum(axis=1)])])
def test_gains_beside_flexible_columns_are_those_of_all_fitted_together(flexible, per_run):
    """Some blocks do not count; a column that others make up takes nothing away."""
    some = np.arange(COUNT) % 7 > 0
    plain = problem(trusted=some)
    run = plain.blocked.run
    projected = replace(plain, nuisance=nuisance_of(flexible, per_run, run, some))
    own = [per_run * (run == number)[:, None] for number in np.unique(run)]
    columns = np.hstack([COLUMNS, flexible, *own])[some]
    expected, *_ = np.linalg.lstsq(columns, TARGET[some], rcond=None)
    found = projected.solve(COLUMNS, TARGET)
    assert found.gains == pytest.approx(expected[:3], rel=1e-6)
    left = TARGET[some] - columns @ expected
    assert found.sse.sum() == pytest.approx(left @ left, rel=1e-6)


def test_what_the_flexible_columns_explain_is_gone():
    nuisance = nuisance_of(FLEXIBLE, PER_RUN, problem().blocked.run, np.ones(COUNT, dtype=bool))
    assert nuisance.remove(FLEXIBLE @ [1.0, -2.0, 0.5, 3.0]) == pytest.approx(0.0, abs=1e-9)
    assert nuisance.remove(PER_RUN) == pytest.approx(0.0, abs=1e-9)
    once = nuisance.remove(TARGET)
    assert nuisance.remove(once) == pytest.approx(once)
