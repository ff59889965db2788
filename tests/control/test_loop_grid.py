"""The grid neither drifts nor bunches: checked with exact fractions as the reference."""

from fractions import Fraction
from math import ceil

import pytest
from hypothesis import given
from hypothesis import strategies as st

from control.loop.timing import TickGrid


def test_ends_where_the_periods_end_after_a_hundred_thousand_ticks():
    grid = TickGrid(start_s=12345.678, period_s=0.001)
    for _ in range(100_000):
        grid.advance(grid.due_s + 0.0004)
    assert grid.due_s == pytest.approx(12345.678 + 100.0, abs=1e-9)
    assert grid.overruns == 0


def test_a_tick_that_ends_exactly_when_the_next_is_due_has_not_overrun():
    grid = TickGrid(0.0, 0.25)
    assert grid.advance(0.25) == 1
    assert grid.overruns == 0


def test_an_overrun_goes_on_at_the_next_instant_ahead_and_is_counted():
    grid = TickGrid(0.0, 0.25)
    assert grid.advance(0.8) == 4  # due at 0; 0.25, 0.5 and 0.75 have passed
    assert (grid.due_s, grid.overruns, grid.skipped) == (1.0, 1, 3)
    assert grid.advance(1.1) == 1  # no burst to catch up
    assert (grid.due_s, grid.overruns, grid.skipped) == (1.25, 1, 3)


@given(
    start=st.integers(-(2**30), 2**30),
    period_exponent=st.integers(-14, 0),
    busy=st.lists(st.integers(0, 2**24), min_size=1, max_size=60),
)
def test_every_tick_is_the_first_instant_that_has_not_passed(start, period_exponent, busy):
    period_s = 2.0**period_exponent  # powers of two: floats are exact, so that fractions are a true reference
    grid = TickGrid(start / 2**10, period_s)
    for busy_ticks in busy:
        index = grid.index
        now_s = grid.due_s + busy_ticks / 2**20
        step = grid.advance(now_s)
        exact = (Fraction(now_s) - Fraction(start, 2**10)) / Fraction(period_s)
        assert grid.index == max(index + 1, ceil(exact))
        assert step == grid.index - index
    assert grid.index == len(busy) + grid.skipped


@given(
    start_s=st.floats(-1e6, 1e6),
    rate_hz=st.floats(1.0, 20_000.0),
    busy_periods=st.lists(st.floats(0.0, 30.0), min_size=1, max_size=60),
)
def test_whatever_the_rounding_no_tick_is_due_in_the_past(start_s, rate_hz, busy_periods):
    grid = TickGrid(start_s, 1.0 / rate_hz)
    for busy in busy_periods:
        index = grid.index
        now_s = grid.due_s + busy / rate_hz
        grid.advance(now_s)
        assert grid.due_s >= now_s
        assert grid.due_s - now_s <= 1.001 / rate_hz + 1e-9
        assert grid.index > index
    assert grid.index == len(busy_periods) + grid.skipped
