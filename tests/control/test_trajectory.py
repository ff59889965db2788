"""Free-air motions: continuous to acceleration, within limits, and they arrive."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from control.paths.trajectory import (
    JointMove,
    LineReturn,
    LineState,
    SpeedBlend,
    blend_distance_m,
    turning_distance_m,
)
from robot_io.errors import InputError

STEP_S = 1e-4
speeds = st.floats(-0.3, 0.3)


def assert_is_smooth(at, duration_s: float, jerk: float) -> None:
    """Each derivative is the slope of the one before, and acceleration has no steps."""
    times = np.linspace(-0.01, duration_s + 0.01, 400)
    for time_s in times:
        behind, now, ahead = at(time_s - STEP_S), at(time_s), at(time_s + STEP_S)
        slope = (ahead.travel_m - behind.travel_m) / (2 * STEP_S)
        bend = (ahead.speed_m_s - behind.speed_m_s) / (2 * STEP_S)
        assert now.speed_m_s == pytest.approx(slope, abs=1e-6 + jerk * STEP_S**2)
        assert now.acceleration_m_s2 == pytest.approx(bend, abs=1e-6 + jerk * STEP_S)
        assert abs(ahead.acceleration_m_s2 - behind.acceleration_m_s2) <= 2.1 * STEP_S * jerk + 1e-9


def clamped(motion, start: LineState):
    """The motion as it is joined to rest or constant speed before it."""

    def at(time_s: float) -> LineState:
        if time_s < 0.0:
            return LineState(start.travel_m + start.speed_m_s * time_s, start.speed_m_s)
        return motion.at(time_s)

    return at


@given(speeds, speeds)
def test_a_change_of_speed_is_smooth_and_within_its_limit(before, after):
    start = LineState(0.1, before)
    blend = SpeedBlend(start, after, 3.0)
    jerk = 6.0 * max(abs(after - before), 1e-3) / blend.duration_s**2
    assert_is_smooth(clamped(blend, start), blend.duration_s, jerk)
    times = np.linspace(0.0, blend.duration_s, 50)
    assert max(abs(blend.at(t).acceleration_m_s2) for t in times) <= 3.0 + 1e-9
    end = blend.at(blend.duration_s + 1.0)
    assert end.speed_m_s == after
    travelled = 0.5 * (before + after) * blend.duration_s + after * 1.0
    assert end.travel_m == pytest.approx(0.1 + travelled)


def test_a_change_of_speed_takes_up_the_acceleration_it_finds():
    blend = SpeedBlend(LineState(0.0, 0.1, -1.0), -0.1, 3.0)
    assert blend.at(0.0) == LineState(0.0, 0.1, -1.0)
    assert blend.at(blend.duration_s - 1e-9).acceleration_m_s2 == pytest.approx(0.0, abs=1e-6)


def test_run_up_distance_is_what_the_blend_needs():
    blend = SpeedBlend(LineState(0.0), 0.15, 3.0)
    assert blend.at(blend.duration_s).travel_m == pytest.approx(blend_distance_m(0.15, 3.0))


def test_turning_distance_is_how_far_a_reversal_still_goes_forward():
    blend = SpeedBlend(LineState(0.0, 0.15), -0.15, 3.0)
    furthest = max(blend.at(t).travel_m for t in np.linspace(0.0, blend.duration_s, 1001))
    assert furthest == pytest.approx(turning_distance_m(0.15, 3.0), rel=1e-4)


@given(st.floats(0.03, 0.5), st.floats(-0.15, 0.05))
def test_a_return_arrives_at_rest_where_it_should(way_m, speed_m_s):
    start = LineState(way_m, speed_m_s)
    back = LineReturn(start, 0.0, 0.15, 3.0)
    end = back.at(back.duration_s)
    assert end.travel_m == pytest.approx(0.0, abs=1e-9)
    assert end.speed_m_s == pytest.approx(0.0, abs=1e-12)
    jerk = 6.0 * 0.2 / (1.5 * 1e-3 / 3.0) ** 2  # of the shortest blend
    assert_is_smooth(clamped(back, start), back.duration_s, jerk)
    states = [back.at(t) for t in np.linspace(0.0, back.duration_s, 100)]
    assert max(abs(state.speed_m_s) for state in states) <= 0.15 + 1e-9
    assert max(abs(state.acceleration_m_s2) for state in states) <= 3.0 + 1e-9


def test_too_short_a_way_back_overshoots_by_no_more_than_stopping_needs():
    back = LineReturn(LineState(0.001, -0.15), 0.0, 0.15, 3.0)
    end = back.at(back.duration_s)
    assert end.speed_m_s == pytest.approx(0.0, abs=1e-12)
    assert -0.01 < end.travel_m < 0.0


@given(
    st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array), st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
)
def test_a_joint_move_is_smooth_arrives_and_keeps_its_limits(start, end):
    move = JointMove(start, end, 1.0, 4.0)
    for time_s in (-1.0, 0.0):
        assert move.at(time_s).position_rad == pytest.approx(start)
    final = move.at(move.duration_s)
    assert final.position_rad == pytest.approx(end)
    assert not final.velocity_rad_s.any()
    for time_s in np.linspace(0.0, move.duration_s, 60):
        now, ahead = move.at(time_s), move.at(time_s + STEP_S)
        assert np.abs(now.velocity_rad_s).max() <= 1.0 + 1e-9
        assert np.abs(now.acceleration_rad_s2).max() <= 4.0 + 1e-9
        rate = (ahead.position_rad - now.position_rad) / STEP_S
        assert (now.velocity_rad_s + ahead.velocity_rad_s) / 2 == pytest.approx(rate, abs=1e-5)
        bend = (ahead.velocity_rad_s - now.velocity_rad_s) / STEP_S
        assert (now.acceleration_rad_s2 + ahead.acceleration_rad_s2) / 2 == pytest.approx(
            bend, abs=0.03 + 60.0 * STEP_S / move.duration_s
        )


def test_a_move_uses_one_of_its_limits():
    far = JointMove(np.zeros(3), np.array([3.0, 0.1, 0.0]), 1.0, 100.0)
    near = JointMove(np.zeros(3), np.array([0.01, 0.0, 0.0]), 1.0, 4.0)
    speed = max(np.abs(far.at(t).velocity_rad_s).max() for t in np.linspace(0, far.duration_s, 1001))
    push = max(np.abs(near.at(t).acceleration_rad_s2).max() for t in np.linspace(0, near.duration_s, 1001))
    assert speed == pytest.approx(1.0, rel=1e-4)
    assert push == pytest.approx(4.0, rel=1e-4)


def test_no_way_is_no_time():
    move = JointMove(np.ones(3), np.ones(3), 1.0, 4.0)
    assert move.duration_s == pytest.approx(0.0, abs=0.01)
    assert move.at(0.0).position_rad == pytest.approx(np.ones(3))


@pytest.mark.parametrize(
    "make",
    [
        lambda: JointMove(np.zeros(3), np.ones(3), 0.0, 1.0),
        lambda: SpeedBlend(LineState(0.0), 0.1, -1.0),
        lambda: LineReturn(LineState(0.1), 0.0, 0.0, 1.0),
    ],
)
def test_limits_must_be_positive(make):
    with pytest.raises(InputError, match="must be positive"):
        make()
