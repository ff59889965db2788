"""Readings by their sensor's own time: what has become late is dated back, and nothing else is."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_io.drivers.serial_force.stream import OwnTime
from sim_backend.emulators import FaultKind
from tests.wire.parts import BOTA, CELL, NET_FT, ODRIVE

PERIOD_S, ALWAYS_S = 1e-3, 0.7e-3


def dated(late_s, clock=1.0, prompt=None, rate_error=0.0):
    """How much older than it arrived each reading is held to be; they are sampled at a steady rate [s]."""
    own_time, ages_s = OwnTime(rate_error), []
    for k, late in enumerate(late_s):
        own_time.goes_on(clock * PERIOD_S)
        arrived_s = 1000.0 + k * PERIOD_S + ALWAYS_S + late
        is_prompt = prompt is None or prompt[k]
        ages_s.append(arrived_s - own_time.sampled_at_s(arrived_s, prompt=is_prompt))
    return ages_s


@given(st.lists(st.floats(0, 0.05), min_size=1, max_size=50))
def test_what_comes_late_is_as_old_as_that_once_one_came_in_time(late_s):
    for age_s, late in zip(dated([0.0, *late_s]), [0.0, *late_s], strict=True):
        assert age_s == pytest.approx(late, abs=1e-3 * PERIOD_S * (len(late_s) + 1) + 1e-9)


@pytest.mark.parametrize("clock", [0.9991, 1.0, 1.0009])
def test_a_clock_that_is_a_little_off_makes_nothing_late(clock):
    assert max(dated([0.0] * 20_000, clock)) < 2e-6


@pytest.mark.parametrize("clock", [0.91, 0.95, 0.998, 1.0015, 1.05, 1.09])
def test_a_rate_that_is_off_is_followed_and_what_becomes_late_shows_all_the_same(clock):
    late_s = [0.0] * 4_000 + [0.012] * 2_000
    ages_s = dated([late + 1e-4 * (k % 7) for k, late in enumerate(late_s)], clock, rate_error=0.1)
    assert max(ages_s[3_000:4_000]) < 1e-3
    assert min(ages_s[4_000:]) > 0.009  # 0.15 % of 2 s may be the clocks


def test_after_a_long_silence_readings_are_not_late_for_ever():
    own_time = OwnTime(longest_gap_s=0.8)
    own_time.goes_on(PERIOD_S)
    own_time.sampled_at_s(1.0, prompt=True)
    for arrived_s in (3.0, 3.0 + PERIOD_S):
        own_time.goes_on(PERIOD_S)
        assert own_time.sampled_at_s(arrived_s, prompt=True) == pytest.approx(arrived_s, abs=1e-5)


def test_a_look_that_was_late_makes_no_later_reading_late():
    """Its bytes are taken to be as old as the look before: that is no short way from the sensor."""
    late_s = [0.0] * 5 + [-0.02] + [0.0] * 5
    assert max(dated(late_s, prompt=[late == 0.0 for late in late_s])) < 1e-4


@pytest.mark.parametrize("changes", [NET_FT, BOTA, (CELL,)], ids=["net_ft", "bota", "cell"])
@pytest.mark.parametrize("late_s", [0.002, 0.008, 0.012])
def test_a_stream_that_has_become_late_is_not_served_as_fresh(bench, changes, late_s):
    arm = bench(ODRIVE, changes)
    arm.robot.configure()

    def ages_s(ticks):
        ages = [-arm.tick(None).force_at_s + arm.clock.now_s() for _ in range(ticks)]
        return ages[20:]

    period_s = 1 / 320 if CELL in changes else 1e-3
    assert max(ages_s(100)) < period_s + 0.5e-3
    arm.strike("load_cell", FaultKind.DELAY, delay_s=late_s)
    assert min(ages_s(400)) > late_s - 0.5e-3
    assert ("the last one came " in arm.problem) == (late_s > 0.005)  # half of the age limit
