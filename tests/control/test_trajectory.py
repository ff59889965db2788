"""Free-air motions: continuous acceleration, limits and arrival."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from palpate.control.arm.inverse_kinematics import Elbow, PlanarArm
from palpate.control.paths.excitation import Excitation, Profile, position_amplitude_m
from palpate.control.paths.press_line import PressLine
from palpate.control.paths.trajectory import (
    JointMove,
    LineReturn,
    LineState,
    SpeedBlend,
    blend_distance_m,
    turning_distance_m,
)
from palpate.robot_io.errors import InputError
from tests.control.reference_plant import DOWN, TOOL_AXIS_TIP, test_arm

STEP_S = 1e-4
speeds = st.floats(-0.3, 0.3)


def assert_is_smooth(at, duration_s: float, jerk: float) -> None:
    """Each derivative is the slope of the one before, and acceleration has no steps."""
    for time_s in np.linspace(-0.01, duration_s + 0.01, 400):
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
def test_speed_change_is_smooth_and_within_its_limit(before, after):
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


def test_speed_change_continues_the_current_acceleration():
    blend = SpeedBlend(LineState(0.0, 0.1, -1.0), -0.1, 3.0)
    assert blend.at(0.0) == LineState(0.0, 0.1, -1.0)
    assert blend.at(blend.duration_s - 1e-9).acceleration_m_s2 == pytest.approx(0.0, abs=1e-6)


def test_run_up_and_turning_distance_match_blends_and_reversals():
    blend = SpeedBlend(LineState(0.0), 0.15, 3.0)
    assert blend.at(blend.duration_s).travel_m == pytest.approx(blend_distance_m(0.15, 3.0))
    blend = SpeedBlend(LineState(0.0, 0.15), -0.15, 3.0)
    furthest = max(blend.at(t).travel_m for t in np.linspace(0.0, blend.duration_s, 1001))
    assert furthest == pytest.approx(turning_distance_m(0.15, 3.0), rel=1e-4)


@given(st.floats(0.03, 0.5), st.floats(-0.15, 0.05))
def test_line_return_ends_at_rest_at_its_goal(way_m, speed_m_s):
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


def test_short_way_back_overshoots_by_no_more_than_stopping_needs():
    back = LineReturn(LineState(0.001, -0.15), 0.0, 0.15, 3.0)
    end = back.at(back.duration_s)
    assert end.speed_m_s == pytest.approx(0.0, abs=1e-12)
    assert -0.01 < end.travel_m < 0.0


@given(
    st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array), st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
)
def test_joint_move_is_smooth_arrives_and_keeps_its_limits(start, end):
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
        assert (now.acceleration_rad_s2 + ahead.acceleration_rad_s2) / 2 == pytest.approx(
            (ahead.velocity_rad_s - now.velocity_rad_s) / STEP_S, abs=0.03 + 60.0 * STEP_S / move.duration_s
        )


def test_move_uses_one_of_its_limits_and_zero_distance_takes_no_time():
    far = JointMove(np.zeros(3), np.array([3.0, 0.1, 0.0]), 1.0, 100.0)
    near = JointMove(np.zeros(3), np.array([0.01, 0.0, 0.0]), 1.0, 4.0)
    speed = max(np.abs(far.at(t).velocity_rad_s).max() for t in np.linspace(0, far.duration_s, 1001))
    push = max(np.abs(near.at(t).acceleration_rad_s2).max() for t in np.linspace(0, near.duration_s, 1001))
    assert speed == pytest.approx(1.0, rel=1e-4)
    assert push == pytest.approx(4.0, rel=1e-4)
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


EXCITATION_STEP_S = 1e-5
SHAPES = ["multisine", "chirp"]


def values(profile: Profile, step_s: float = 1e-3) -> np.ndarray:
    times = np.arange(0.0, profile.duration_s, step_s)
    return np.array([profile.at(time_s)[0] for time_s in times])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("offset", [1.0, 3.0])
def test_friction_starts_at_rest_and_only_dissipates(shape, offset):
    profile = Profile(Excitation(shape=shape), offset)
    assert profile.at(0.0) == (0.0, 0.0, 0.0)
    found = values(profile)
    assert found.max() <= 1e-3
    assert found.min() >= -offset - 1.0 - 1e-3
    assert np.ptp(found[1000:]) > 1.5


@pytest.mark.parametrize("shape", SHAPES)
def test_excitation_derivatives_are_exact_and_its_power_is_in_band(shape):
    profile = Profile(Excitation(shape=shape))
    for time_s in np.linspace(0.01, 3.9, 60):
        behind, now, ahead = (profile.at(time_s + s) for s in (-EXCITATION_STEP_S, 0.0, EXCITATION_STEP_S))
        slopes = np.subtract(ahead, behind) / (2 * EXCITATION_STEP_S)
        assert now[1] == pytest.approx(slopes[0], abs=1e-4)
        assert now[2] == pytest.approx(slopes[1], abs=0.02)
    excitation = Excitation(shape=shape, low_hz=1.0, high_hz=6.0, duration_s=8.0)
    found = values(Profile(excitation))[round(excitation.ramp_s * 500) :]  # from half way into the fade
    power = np.abs(np.fft.rfft(found - found.mean())) ** 2
    hertz = np.fft.rfftfreq(len(found), 1e-3)
    assert power[hertz > 7.0].sum() / power.sum() < 0.01
    assert power[hertz < 0.8].sum() / power.sum() < 0.5
    for low, high in ((0.9, 2.2), (2.2, 4.0), (4.0, 6.2)):
        assert power[(hertz > low) & (hertz < high)].sum() / power.sum() > 0.05


def test_position_and_force_amplitude_match_the_object():
    excitation = Excitation(amplitude_n=1.5, high_hz=8.0)
    stiff, offset = position_amplitude_m(
        excitation, stiffness_n_m=7100.0, damping_n_s_m=0.0, force_limit_n=10.0, speed_limit_m_s=0.15
    )
    assert stiff == pytest.approx(1.5 / 7100.0)
    assert offset == 1.0
    soft, _ = position_amplitude_m(
        excitation, stiffness_n_m=100.0, damping_n_s_m=0.0, force_limit_n=10.0, speed_limit_m_s=0.15
    )
    assert soft * 2 * np.pi * 8.0 <= 0.15 + 1e-12  # the speed limit, not 15 mm
    damped, offset = position_amplitude_m(
        excitation, stiffness_n_m=500.0, damping_n_s_m=50.0, force_limit_n=10.0, speed_limit_m_s=0.15
    )
    assert offset > 1.0
    assert damped * np.hypot(500.0, 2 * np.pi * 8.0 * 50.0) <= 1.5 + 1e-9


@pytest.mark.parametrize(
    "changes", [{"low_hz": 9.0}, {"amplitude_n": 0.0}, {"duration_s": 1.0}, {"shape": "square"}, {"amp": 1}]
)
def test_invalid_trajectories_are_refused(changes):
    with pytest.raises(ValidationError):
        Excitation(**changes)


START = np.array([0.42, 0.0, 0.10])
SLANTED = np.array([0.6, 0.0, -0.8])
NOWHERE = (np.full(3, -9.0), np.full(3, 9.0))


def line(start=START, direction=DOWN, elbow=Elbow.POSITIVE) -> PressLine:
    return PressLine(PlanarArm(test_arm(), TOOL_AXIS_TIP), start, direction, elbow)


@pytest.mark.parametrize("direction", [DOWN, SLANTED])
@pytest.mark.parametrize("elbow", list(Elbow))
def test_tip_follows_the_line_and_keeps_the_tool_direction(direction, elbow):
    body, press = test_arm(), line(direction=direction, elbow=elbow)
    near = press.start.position_rad
    for travel_m in (0.0, 0.02, 0.05):
        motion = press.joint_motion(LineState(travel_m, 0.15, 2.0), near)
        tip = body.tip_motion(motion.position_rad, motion.velocity_rad_s)
        assert tip.position_world_m == pytest.approx(START + travel_m * direction, abs=1e-9)
        assert tip.velocity_world_m_s == pytest.approx(0.15 * direction, abs=1e-9)
        assert tip.rotation_world_tip @ TOOL_AXIS_TIP == pytest.approx(direction, abs=1e-9)
        assert tip.jacobian_world[3:] @ motion.velocity_rad_s == pytest.approx(np.zeros(3), abs=1e-9)
        assert press.travel_of(tip.position_world_m) == pytest.approx(travel_m, abs=1e-12)


def test_joint_velocity_and_acceleration_match_finite_differences():
    press, step_s = line(direction=SLANTED), 1e-4
    near = press.start.position_rad

    def at(time_s: float):
        speed, acceleration = 0.1 + 1.5 * time_s, 1.5
        return press.joint_motion(
            LineState(0.02 + 0.1 * time_s + 0.75 * time_s**2, speed, acceleration), near
        )

    behind, now, ahead = at(-step_s), at(0.0), at(step_s)
    velocity = (ahead.position_rad - behind.position_rad) / (2 * step_s)
    acceleration = (ahead.velocity_rad_s - behind.velocity_rad_s) / (2 * step_s)
    assert now.velocity_rad_s == pytest.approx(velocity, abs=1e-6)
    assert now.acceleration_rad_s2 == pytest.approx(acceleration, abs=1e-5)


def test_positions_stay_on_their_turn():
    press = line()
    near = press.start.position_rad + np.array([2 * np.pi, -2 * np.pi, 0.0])
    assert press.joint_motion(LineState(0.0), near).position_rad == pytest.approx(near)


def test_reach_ends_at_the_arm_and_at_the_joint_limits():
    press = line()
    near = press.start.position_rad
    assert press.reach_m(0.05, near, NOWHERE) == pytest.approx(0.05)
    far_m = press.reach_m(2.0, near, NOWHERE)
    assert 0.1 < far_m < 1.0
    press.joint_motion(LineState(far_m), near)  # reachable
    with pytest.raises(InputError, match=r"reach|singular"):
        press.joint_motion(LineState(far_m + 0.02), near)
    assert press.reach_m(-2.0, near, NOWHERE) < -0.1
    tight = (near - 0.05, near + 0.05)
    limited_m = press.reach_m(2.0, near, tight)
    assert 0.0 < limited_m < far_m
    moved = press.joint_motion(LineState(limited_m), near).position_rad
    assert (np.abs(moved - near) <= 0.05).all()


def test_unreachable_start_is_refused():
    with pytest.raises(InputError, match="out of reach"):
        line(start=np.array([0.9, 0.0, 0.1]))
