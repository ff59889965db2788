"""Where a search along one inner parameter looks next."""

import pytest

from estimation.effect import Parameter
from estimation.fit.inner_search import _between


@pytest.mark.parametrize(
    ("values", "best", "log", "expected"),
    [
        ([1.0, 2.0, 4.0, 8.0], 1, False, [1.5, 3.0]),
        ([1.0, 2.0, 4.0, 8.0], 2, False, [3.0, 6.0]),
        ([1.0, 4.0, 16.0], 1, True, [2.0, 8.0]),
        ([1.0, 4.0, 16.0], 0, True, [2.0]),
        ([10.0, 40.0, 100.0], 2, False, [70.0]),
    ],
)
def test_half_way_to_both_neighbours_and_never_beyond_the_bounds(values, best, log, expected):
    inner = Parameter("width", "m", 1.0, 100.0, (2.0, 50.0), log=log)
    grid = [{"width": value, "other": 3.0} for value in values]
    found = _between(grid, best, inner, list(range(len(grid))))
    assert [point["width"] for point in found] == pytest.approx(expected)
    assert all(point["other"] == 3.0 for point in found)
