"""Histogram percentiles against numpy, and the tick grid against exact fractions."""

import math
import tracemalloc
from fractions import Fraction
from math import ceil

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from palpate.control.loop.timing import SECTIONS, Histogram, LoopTiming, TickDurations, TickGrid

BIN_ERROR = 0.012  # half a bin


def filled(durations_s) -> Histogram:
    histogram = Histogram()
    for part_s in np.array_split(np.asarray(durations_s), 3):
        histogram.add(part_s)
    return histogram


@given(st.lists(st.floats(1e-7, 30.0), min_size=1, max_size=200), st.floats(0.1, 100.0))
def test_percentiles_agree_with_numpy_for_any_durations(durations_s, percent):
    rank = percent / 100.0 * len(durations_s)
    assume(abs(rank - round(rank)) > 1e-6)  # at whole ranks numpy's own rounding may take the neighbor
    expected = np.percentile(durations_s, percent, method="inverted_cdf")
    assert filled(durations_s).percentile(percent) == pytest.approx(expected, rel=BIN_ERROR)


def test_longest_duration_is_exact_and_bounds_percentiles():
    histogram = filled([1e-4, 2e-4, 3.3e-4])
    assert histogram.max_s == 3.3e-4
    assert histogram.percentile(100.0) <= 3.3e-4
    assert filled([1e-5] * 999 + [1.0]).summary().p999_s == pytest.approx(1e-5, rel=BIN_ERROR)
    assert filled([1e-5] * 990 + [1.0] * 10).summary().p99_s == pytest.approx(1e-5, rel=BIN_ERROR)
    assert math.isnan(Histogram().percentile(50.0))


def test_zero_and_huge_durations_are_counted():
    histogram = filled([0.0] * 6 + [1e4] * 4)
    assert histogram.count == 10
    assert histogram.percentile(50.0) == 0.0
    assert histogram.percentile(90.0) == pytest.approx(32.0, rel=0.03)
    assert histogram.max_s == 1e4
    assert filled([5.8e-8]).percentile(50.0) == 0.0 < filled([6.2e-8]).percentile(50.0)


@pytest.mark.parametrize("count", [1, 100, 1000])
def test_tick_time_is_the_sum_of_all_sections_except_lateness(count):
    timing = LoopTiming()
    for number in range(count):
        timing.add(TickDurations(*(1e-6 * (i + 1) * (1 + number / count) for i in range(7))))
    summary = timing.summary()
    assert tuple(summary) == SECTIONS
    for i, name in enumerate(name for name in SECTIONS if name != "tick"):
        assert summary[name].count == count
        assert summary[name].p50_s == pytest.approx(1.5e-6 * (i + 1), rel=BIN_ERROR + 0.5 / count)
        assert summary[name].max_s == pytest.approx(1e-6 * (i + 1) * (2 - 1 / count))
    assert summary["tick"].max_s == pytest.approx(21e-6 * (2 - 1 / count))
    assert timing.summary()["tick"].count == count


def test_hours_of_ticks_take_no_more_memory_than_a_minute():
    timing, durations = LoopTiming(), [TickDurations(*(1e-6 * n + i for i in range(7))) for n in range(500)]

    def grown_bytes(ticks):
        tracemalloc.start()
        for number in range(ticks):
            timing.add(durations[number % len(durations)])
        grown, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return grown

    grown_bytes(5_000)
    assert grown_bytes(10_000) < 100_000
    assert timing.summary()["tick"].count == 15_000


def test_punctual_tick_is_no_overrun_and_next_tick_is_the_next_instant():
    grid = TickGrid(0.0, 0.25)
    assert grid.advance(0.25) == 1
    assert grid.overruns == 0
    grid = TickGrid(0.0, 0.25)
    assert grid.advance(0.8) == 4  # due at 0; 0.25, 0.5 and 0.75 have passed
    assert (grid.due_s, grid.overruns, grid.skipped) == (1.0, 1, 3)
    assert grid.advance(1.1) == 1  # no burst to catch up
    assert (grid.due_s, grid.overruns, grid.skipped) == (1.25, 1, 3)
    assert grid.advance(2.0) == 3  # an instant that is now has not passed
    assert (grid.due_s, grid.overruns, grid.skipped) == (2.0, 2, 5)


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
def test_tick_is_never_due_in_the_past(start_s, rate_hz, busy_periods):
    grid = TickGrid(start_s, 1.0 / rate_hz)
    for busy in busy_periods:
        index = grid.index
        now_s = grid.due_s + busy / rate_hz
        grid.advance(now_s)
        assert grid.due_s >= now_s
        assert grid.due_s - now_s <= 1.001 / rate_hz + 1e-9
        assert grid.index > index
    assert grid.index == len(busy_periods) + grid.skipped
