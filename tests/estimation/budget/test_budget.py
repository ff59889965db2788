"""Error shares by kind, against games with known values and sums over all orders."""

from itertools import permutations

import numpy as np
import pytest

from palpate.estimation.budget import error_budget
from palpate.estimation.kinds import Kind

pytestmark = pytest.mark.usefixtures("whole_budget")
ELASTIC, RATE, FRICTION, MEMORY, BIAS, RUNS = (
    Kind.ELASTIC_SHAPE,
    Kind.RATE_DEPENDENCE,
    Kind.FRICTION,
    Kind.TIME_MEMORY,
    Kind.SENSOR_STATICS,
    Kind.RUN_DIFFERENCES,
)


class Game:
    """Errors of sets of kinds that a function gives, the same in each of four runs."""

    counts, runs = np.full(4, 10.0), 4

    def __init__(self, kinds, left):
        self.kinds, self._left = kinds, left

    def mean_square(self, kinds=frozenset()):
        return self._left(frozenset(kinds))

    def by_run(self, kinds):
        return self.counts * self.mean_square(kinds)


def budget(kinds, left, only=None):
    return error_budget(Game(kinds, left), np.random.default_rng(0), only)


def test_disjoint_kinds_get_their_own_shares():
    takes = {ELASTIC: 6.0, RATE: 3.0, FRICTION: 0.0}
    found = budget(list(takes), lambda kinds: 10.0 - sum(takes[kind] for kind in kinds))
    assert found.kinds == (ELASTIC, RATE)
    for entry in found.entries:
        share = takes[entry.kind] / 10.0
        assert (entry.share, entry.necessary, entry.sufficient) == pytest.approx((share,) * 3)
        assert entry.interval == pytest.approx((share, share))  # all runs are alike
        assert entry.replaceable_by == ()
    assert found.unexplained == found.unexplained_by_all == pytest.approx(0.1)
    assert found.base == pytest.approx(np.sqrt(10.0))


def test_shares_are_shapley_values_over_all_orders():
    """Four kinds that help and hinder each other."""
    kinds = (ELASTIC, RATE, FRICTION, MEMORY)
    rng = np.random.default_rng(3)
    single, pair = rng.uniform(0.5, 1.5, 4), rng.uniform(0.0, 0.3, (4, 4))

    def left(members):
        chosen = [number for number, kind in enumerate(kinds) if kind in members]
        return (
            10.0 - sum(single[i] for i in chosen) - sum(pair[i, j] for i in chosen for j in chosen if i < j)
        )

    expected = dict.fromkeys(kinds, 0.0)
    for order in permutations(kinds):
        for place, kind in enumerate(order):
            expected[kind] += (left(order[:place]) - left(order[: place + 1])) / 24.0 / 10.0
    found = budget(kinds, left, only=frozenset(kinds))
    assert {entry.kind: entry.share for entry in found.entries} == pytest.approx(expected)
    assert sum(expected.values()) + found.unexplained == pytest.approx(1.0)


def test_equivalent_kinds_are_merged_and_replaceable():
    """What the object does bears the name before what the sensor does."""
    found = budget([BIAS, ELASTIC], lambda kinds: 1.0 if kinds else 10.0)
    (entry,) = found.entries
    assert (entry.kind, entry.replaceable_by) == (ELASTIC, (BIAS,))
    assert (entry.necessary, entry.sufficient) == pytest.approx((0.0, 0.9))
    assert found.alternatives == (frozenset({BIAS}),)


@pytest.mark.parametrize(
    "left", [lambda kinds: 10.0, lambda kinds: 0.0, lambda kinds: 10.0 - 0.1 * len(kinds)]
)
def test_no_kind_has_a_share_without_explained_error(left):
    found = budget([ELASTIC, RATE], left)
    assert found.entries == ()
    assert found.unexplained == 1.0


def test_harmful_kind_takes_no_share_from_another():
    takes = {frozenset(): 10.0, frozenset({ELASTIC}): 2.0, frozenset({RATE}): 11.0}
    found = budget([ELASTIC, RATE], lambda kinds: takes.get(kinds, 3.0))
    assert found.kinds == (ELASTIC,)
    assert found.entries[0].share == pytest.approx(0.8)


def test_shared_error_is_attributed_to_the_motion_law():
    """Each takes 6 of 10 alone, and both 8: a gain and a zero of each run imitate much of any law."""
    left = {frozenset(): 10.0, frozenset({MEMORY, RUNS}): 2.0}
    found = budget([MEMORY, RUNS], lambda kinds: left.get(kinds, 4.0))
    assert {entry.kind: entry.share for entry in found.entries} == pytest.approx({MEMORY: 0.6, RUNS: 0.2})
    # Specimens that differ by a gain: a law that all runs have in common takes little of that.
    takes = {ELASTIC: 1.0, RUNS: 8.0}
    found = budget(list(takes), lambda kinds: 10.0 - sum(takes[kind] for kind in kinds))
    assert found.kinds == (RUNS, ELASTIC)
