"""Where a search along one inner parameter looks next."""

from types import SimpleNamespace

import numpy as np
import pytest

from estimation.effect import Parameter
from estimation.fit.inner_search import Attempts, _between, _vertex
from estimation.fit.polish import Scale


@pytest.mark.parametrize(
    ("values", "best", "log", "expected"),
    [
        ([1.0, 2.0, 4.0, 8.0], 1, False, [1.5, 3.0]),
        ([1.0, 2.0, 4.0, 8.0], 2, False, [3.0, 6.0]),
        ([1.0, 4.0, 16.0], 1, True, [2.0, 8.0]),
        ([1.0, 4.0, 16.0], 0, True, [2.0]),
        ([10.0, 40.0, 100.0], 2, False, [70.0]),
        # where the grid ends, twice as far outside as its last step was wide
        ([10.0, 20.0], 1, False, [15.0, 40.0]),
        ([40.0, 50.0], 0, False, [20.0, 45.0]),
        ([1.0, 2.0, 4.0], 2, True, [8.0**0.5, 16.0]),
        ([16.0, 32.0], 0, True, [4.0, 512.0**0.5]),
        ([5.0], 0, False, [1.0, 100.0]),
    ],
)
def test_half_way_to_both_neighbours_and_never_beyond_the_bounds(values, best, log, expected):
    inner = Parameter("width", "m", 1.0, 100.0, (2.0, 50.0), log=log)
    grid = [{"width": value, "other": 3.0} for value in values]
    found = _between(grid, best, inner, list(range(len(grid))))
    assert [point["width"] for point in found] == pytest.approx(expected)
    assert all(point["other"] == 3.0 for point in found)


@pytest.mark.parametrize(
    ("values", "cost", "log", "expected"),
    [
        ([1.0, 2.0, 8.0], lambda x: (x - 3.0) ** 2, False, 3.0),
        ([1.0, 2.0, 8.0], lambda x: 7.0 + 0.1 * (x - 1.5) ** 2, False, 1.5),
        ([1.0, 4.0, 32.0], lambda x: np.log(x / 5.0) ** 2, True, 5.0),
        ([1.0, 2.0, 3.0], lambda x: x, False, None),  # no bend
        ([1.0, 2.0, 8.0], lambda x: 8.0 - (x - 3.0) ** 2, False, None),  # a summit
    ],
)
def test_a_parabola_s_lowest_point_is_looked_at(values, cost, log, expected):
    inner = Parameter("width", "m", 1.0, 100.0, (2.0, 50.0), log=log)
    grid = [{"width": value, "other": 3.0} for value in values]
    trials = [SimpleNamespace(sse=cost(value)) for value in values]
    found = _vertex(grid, trials, [0, 1, 2], 1, inner)
    assert found == ([] if expected is None else [{"width": pytest.approx(expected), "other": 3.0}])
    assert _vertex(grid, trials, [0, 1, 2], 0, inner) == []  # a parabola needs a neighbour on either side


def test_each_fold_is_judged_at_the_inner_parameters_that_the_others_chose():
    def trial(train, held_out):
        return SimpleNamespace(sse=sum(train), scores=SimpleNamespace(train=train, held_out=held_out))

    tried = Attempts((trial([1.0, 5.0, 3.0], [10, 20, 30]), trial([2.0, 4.0, 3.5], [1, 2, 3])), 1)
    assert tried.held_out.tolist() == [10, 2, 30]
    assert tried.starts == tried.trials[:1]
    assert tried.best is tried.trials[0]


@pytest.mark.parametrize(
    ("start", "log", "value", "number"),
    [
        (5.0, True, 10.0, np.log(2.0)),  # by ratio
        (5.0, False, 10.0, 1.0),  # by difference, in units of the start
        (-5.0, True, -10.0, -1.0),
        (0.0, True, 4.8, 0.1),  # or of the typical range where it begins at nothing
        (0.0, False, -4.8, -0.1),
    ],
)
def test_a_search_moves_numbers_of_order_one(start, log, value, number):
    scale = Scale(Parameter("width", "m", -100.0, 100.0, (2.0, 50.0), log=log), start)
    assert scale.number(value) == pytest.approx(number)
    assert scale.value(number) == pytest.approx(value)
    assert scale.number(start) == 0.0
    assert scale.bounds == (scale.number(-100.0), scale.number(100.0))
