"""Frames told apart by their stamps, and the two clocks' offset."""

from math import nan

import numpy as np
import pytest

from control.teleop.peer import Arrival, ClockOffset, Peer, PeerLimits
from robot_io.errors import InputError
from robot_io.link import Frame

FRAME = Frame(1, 77, 0, 100.0, 0, nan, nan, 0, b"")
FRESH, LATE, REPEATED, REORDERED, FOREIGN = Arrival


def frame(sequence: int, sent_s: float = 100.0, **changes) -> Frame:
    return FRAME._replace(sequence=sequence, sent_s=sent_s, **changes)


def judged(*steps: tuple[int, float, float], sender: int = 77) -> tuple[list[Arrival], Peer]:
    """What frames are, given as sequence, time sent and time of arrival."""
    peer = Peer(PeerLimits(late_s=3.0, silent_s=1.0))
    return [peer.judge(frame(n, sent, sender=sender), arrived) for n, sent, arrived in steps], peer


@pytest.mark.parametrize(
    ("steps", "expected", "lost"),
    [
        ([(0, 100.0, 5.0), (1, 100.1, 5.1)], [FRESH, FRESH], 0),
        ([(0, 100.0, 5.0), (0, 100.0, 5.1)], [FRESH, REPEATED], 0),
        ([(0, 100.0, 5.0), (4, 100.4, 5.4)], [FRESH, FRESH], 3),
        (
            [(0, 100.0, 5.0), (2, 100.2, 5.2), (1, 100.1, 5.3), (1, 100.1, 5.4)],
            [FRESH, FRESH, REORDERED, REPEATED],
            0,
        ),
        ([(0, 100.0, 5.0), (1, 100.1, 8.4)], [FRESH, LATE], 0),
        ([(9, 100.0, 5.0), (200, 101.0, 6.0), (10, 100.1, 6.1)], [FRESH, FRESH, REPEATED], 190),
    ],
)
def test_frames_are_told_apart(steps, expected, lost):
    found, peer = judged(*steps)
    assert found == expected
    assert peer.lost == lost
    assert peer.counts == {kind: expected.count(kind) for kind in Arrival}


def test_another_sender_is_foreign_until_the_first_is_silent():
    _, peer = judged((5, 100.0, 5.0))
    stranger = frame(0, 0.0, sender=99)
    assert peer.judge(stranger, 5.9) is FOREIGN
    assert peer.restarts == 0
    assert peer.silent(6.1)
    assert peer.judge(stranger, 6.1) is FRESH
    assert peer.restarts == 1
    assert peer.judge(frame(6, 101.0), 6.2) is FOREIGN


def test_late_frames_do_not_keep_the_peer_alive():
    _, peer = judged((0, 100.0, 5.0))
    for n in range(1, 40):
        assert peer.judge(frame(n, 100.0 + 0.1 * n), 5.0 + 3.5 + 0.1 * n) is LATE
    assert peer.silent(9.0)


def test_the_offset_is_found_through_a_jittery_network():
    """Two clocks 1234 s apart; the answer is within half the round trip, as RFC 5905 says."""
    rng, clocks, offset_s = np.random.default_rng(2), ClockOffset(), 1234.5
    for t0_s in np.arange(0.0, 2.0, 0.02):
        there_s, back_s = 0.005 + rng.exponential(0.02, 2)
        t1_s = t0_s + there_s + offset_s
        t2_s = t1_s + 0.01
        clocks.update(t0_s, t1_s, t2_s, t2_s - offset_s + back_s)
    assert clocks.best is not None
    assert abs(clocks.best.offset_s - offset_s) <= 0.5 * clocks.best.round_trip_s
    assert clocks.best.round_trip_s < 0.02


def test_a_clock_that_slips_is_followed_within_seconds():
    clocks = ClockOffset()
    for t0_s in np.arange(0.0, 10.0, 0.02):
        offset_s = 0.0 if t0_s < 5.0 else 0.5
        clocks.update(t0_s, t0_s + 0.01 + offset_s, t0_s + 0.01 + offset_s, t0_s + 0.02)
    assert clocks.best is not None
    assert clocks.best.offset_s == pytest.approx(0.5)


@pytest.mark.parametrize("stamps", [(nan, 1.0, 2.0, 3.0), (1.0, 2.0, 9.0, 3.0), (5.0, 2.0, 2.0, 3.0)])
def test_stamps_that_contradict_each_other_are_left_out(stamps):
    clocks = ClockOffset()
    clocks.update(*stamps)
    assert clocks.best is None


def test_ages_are_on_the_own_clock():
    peer = Peer(PeerLimits())
    assert peer.age_s(5.0) != peer.age_s(5.0)
    peer.judge(frame(0, 105.02, heard_sent_s=5.0, heard_at_s=105.01), 5.03)
    assert peer.offset is not None
    assert peer.offset.offset_s == pytest.approx(100.0)
    assert peer.age_s(6.0) == pytest.approx(0.98)
    assert peer.since_s(104.0, 6.0) == pytest.approx(2.0)


@pytest.mark.parametrize("limits", [{"late_s": 0.0}, {"silent_s": 61.0}, {"silent_s": nan}])
def test_limits_that_make_no_sense(limits):
    with pytest.raises(InputError):
        PeerLimits(**limits)
