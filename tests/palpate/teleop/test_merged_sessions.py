"""Merged sessions: error of the rendered force, and delays of the machine."""

import numpy as np
import pytest

from palpate.sim_backend.scenario import Scenario
from palpate.teleop.demo import TeleopDemo
from palpate.teleop.merged_sessions import TOUCH_S, ForceComparison, MergedSessions
from palpate.teleop.virtual_object import estimate_data, force_law, terms_of
from tests.robot_io.link.link_parts import estimate

TICK_S = 1e-3
DEPTH_M = 0.003
REAL = Scenario()


class Kept:
    """Samples or a session of a test's making."""

    def __init__(self, **kept):
        self.kept, self.path, self.events = kept, "leader.mcap", ()

    def __getitem__(self, name):
        return self.kept[name]

    def samples(self, name):
        return self.kept[name]


def haptic(withheld_n: float, late_at: int | None) -> Kept:
    """Two touches of half a second, the law's own force less what is withheld in the second one."""
    count = 2000
    inside = np.zeros(count, bool)
    inside[200:700] = inside[1200:1700] = True
    height_m = REAL.object.surface_height_m
    position = np.zeros((count, 3))
    position[:, 2] = np.where(inside, height_m - DEPTH_M, height_m + 0.01)
    law = force_law(terms_of(REAL))
    force_n = np.array([law(DEPTH_M if touched else 0.0, 0.0, TICK_S) for touched in inside])
    force_n[1200:1700] -= withheld_n
    lateness_s = np.zeros(count)
    if late_at is not None:
        lateness_s[late_at] = 8.0 * TICK_S
    return Kept(
        time_s=np.arange(count) * TICK_S,
        tip_position_world_m=position,
        tip_velocity_world_m_s=np.zeros((count, 3)),
        force_n=force_n,
        revision=np.zeros(count, int),
        lateness_s=lateness_s,
    )


@pytest.mark.parametrize("late_at", [1200, 1203])
def test_late_touch_is_excluded_from_the_model_error(late_at):
    felt = MergedSessions(Kept(haptic=haptic(0.5, late_at)), None).compare_rendered_to_real(REAL)
    assert felt.settled().share < 1e-9
    assert felt.stalled.sum() == 500
    assert felt.share > 0.01  # and yet it was felt


@pytest.mark.parametrize("late_at", [None, 300, 1500])
def test_wrong_model_is_not_excused_by_a_late_tick_elsewhere(late_at):
    felt = MergedSessions(Kept(haptic=haptic(0.5, late_at)), None).compare_rendered_to_real(REAL)
    assert felt.stalled.sum() == 0
    assert felt.settled().share == pytest.approx(felt.share, rel=0.01)


def test_first_milliseconds_of_each_touch_are_left_out():
    time_s = np.concatenate([np.arange(100), 500 + np.arange(100)]) * TICK_S
    ones = np.ones(len(time_s))
    settled = ForceComparison(time_s, ones, ones, ones < 0.0).settled()
    assert len(settled.time_s) == len(time_s) - 2 * round(TOUCH_S / TICK_S)


def test_times_of_a_drifting_clock_are_mapped_to_the_leader_s():
    """A simulated follower's clock that runs at half speed for ten seconds."""
    leader_s = np.linspace(100.0, 110.0, 101)
    offset_s = -90.0 - 0.5 * (leader_s - 100.0)
    link = Kept(time_s=leader_s, peer_offset_s=offset_s, round_trip_s=np.full(101, 1e-3))
    merged = MergedSessions(Kept(link=link), Kept(link=link))
    np.testing.assert_allclose(merged.to_leader(leader_s + offset_s), leader_s, atol=1e-9)


@pytest.mark.parametrize(
    ("offset_s", "drift_s", "words"),
    [
        (-47609.327388, 28.0, ("within 0.50 ms", "drifted by 28 s over the session")),
        (0.0012345678, 4e-5, ("within 0.50 ms", "drifted by 0.040 ms over")),
    ],
)
def test_clocks_are_reported_by_the_error_of_the_timeline_and_not_by_their_offset(offset_s, drift_s, words):
    offsets_s = offset_s + np.linspace(0.0, drift_s, 41)
    link = Kept(time_s=np.arange(41.0), peer_offset_s=offsets_s, round_trip_s=np.full(41, 1e-3))
    said = MergedSessions(Kept(link=link), None).clock_summary()
    assert all(part in said for part in words), said
    assert "13.2" not in said
    assert "1.23" not in said


def merged(kept: np.ndarray, late: int, follower_rate: float) -> MergedSessions:
    """Two seconds of haptic ticks, those kept, the first few of them late, and a follower's clock."""
    time_s = 5.0 + np.arange(2000)[kept] * TICK_S
    lateness_s = np.where(np.arange(len(time_s)) < late, 2.0 * TICK_S, 0.1 * TICK_S)
    told_s = 5.0 + np.linspace(0.0, 2.0, 41)
    jitter_s = np.random.default_rng(1).normal(0.0, 1e-3, 41)
    offset_s = -4.0 + (follower_rate - 1.0) * (told_s - 5.0) + jitter_s
    link = Kept(time_s=told_s, peer_offset_s=offset_s, round_trip_s=np.full(41, 1e-3))
    return MergedSessions(Kept(haptic=Kept(time_s=time_s, lateness_s=lateness_s), link=link), None)


def test_machine_that_keeps_pace_is_not_called_slow():
    assert merged(np.ones(2000, bool), late=10, follower_rate=1.0).slowness() == []


def test_slow_machine_is_reported_with_its_figures():
    kept = np.ones(2000, bool)
    kept[500:600] = False
    slow = merged(kept, late=60, follower_rate=0.9)
    assert slow.missed_share == pytest.approx(0.08)
    assert slow.slipped_share == pytest.approx(0.1, abs=0.01)
    ticks, clock = slow.slowness()
    assert "8 %" in ticks
    assert "101 ms" in ticks
    assert "10 %" in clock
    nothing = ForceComparison(*[np.zeros(0)] * 3, np.zeros(0, bool))
    summary = TeleopDemo(slow, nothing, nothing, {}, ended_early=True).slowness_summary()
    assert "too slow" in summary
    assert "stopped after" in summary


def test_rendered_estimate_keeps_its_target():
    assert estimate_data(estimate(target=2**40))["target"] == 2**40
