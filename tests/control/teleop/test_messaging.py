"""Link state: peer, clock offset, disagreement between model and measurement, and leader motion."""

from math import nan
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.teleop.force_mismatch import MismatchMonitor
from palpate.control.teleop.messaging import Arrival, ClockOffset, Messaging, Peer
from palpate.control.teleop.virtual_object import VirtualArm
from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.link.frame import Frame, LastReceived, decode, encode
from palpate.robot_io.link.messages import Intent
from palpate.robot_io.robot_file import load_robot_file
from tests.control.simulated_arms import ARMS

US, PEER, OTHER = 1, 2, 3


def _frame(sender, names, sequence, sent_s):
    said = Intent((), (sequence,), (), ended=False)
    return decode(encode(sender, sequence, sent_s, LastReceived(names, nan, nan), said))


def _side():
    """One side on a clock that begins with 10 s, what is handed to it, and what it answered and did."""
    line = SimpleNamespace(sender=US, role="follower", malformed=0, refused="", advice="look", inbox=[])
    line.named, line.taken, line.begun = [], [], []
    line.send = line.refuse = lambda *_: None
    line.resubscribe = lambda: None
    line.heard = lambda frame, at_s: line.named.append(frame.sender)
    line.receive = lambda: [line.inbox.pop(0) for _ in range(len(line.inbox))]
    clock = SimulatedClock()
    clock.sleep_until(clock.now_s() + 10.0)
    made = Messaging(
        line,
        clock,
        take=lambda message, _: line.taken.extend(message.cancelled),
        on_new_peer=lambda: line.begun.append(1),
    )
    return made, line, clock


def test_peer_is_the_side_that_acknowledged_this_program():
    side, line, clock = _side()
    line.inbox = [(10.0, _frame(PEER, 0, 0, 5.0))]
    side.receive()
    assert (side.linked, line.named, line.taken) == (False, [PEER], [])  # our next frame names it
    line.inbox = [(10.1, _frame(PEER, US, 1, 5.1))]
    clock.sleep_until(clock.now_s() + 0.1)
    side.receive()
    assert (side.linked, line.taken) == (True, [1])


def test_replayed_frames_neither_keep_a_link_alive_nor_replace_the_peer():
    side, line, clock = _side()
    line.inbox = [(10.0, _frame(PEER, US, 0, 5.0))]
    side.receive()
    for number in range(200):  # the peer dies, and somebody plays what another follower was told
        clock.sleep_until(clock.now_s() + 0.05)
        line.inbox = [(clock.now_s(), _frame(OTHER, 99, number, 50_000.0 + 0.05 * number))]
        side.receive()
    assert (side.linked, line.taken, line.begun) == (False, [0], [])
    clock.sleep_until(clock.now_s() + 10.0)
    line.inbox = [(clock.now_s(), _frame(4, US, 0, 7.0))]
    side.receive()
    assert (side.linked, line.taken, line.begun) == (True, [0, 0], [1])


def test_unanswered_peer_is_informed_of_another_connection():
    side, line, clock = _side()
    line.inbox = [(10.0, _frame(PEER, OTHER, 0, 5.0))]
    side.receive()
    assert not side.problem()  # from now on, silence counts
    clock.sleep_until(clock.now_s() + 11.0)
    assert "answers another program" in side.problem()
    assert not side.problem()


FRAME = Frame(1, 77, 0, 100.0, 0, nan, nan, 0, b"")
FRESH, LATE, REPEATED, REORDERED, FOREIGN = Arrival


def frame(sequence: int, sent_s: float = 100.0, **changes) -> Frame:
    return FRAME._replace(sequence=sequence, sent_s=sent_s, **changes)


def judged(*steps: tuple[int, float, float], sender: int = 77) -> tuple[list[Arrival], Peer]:
    """What frames are, given as sequence, time sent and time of arrival."""
    peer = Peer()
    return [peer.classify(frame(n, sent, sender=sender), arrived) for n, sent, arrived in steps], peer


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
def test_frame_types_are_distinguished(steps, expected, lost):
    found, peer = judged(*steps)
    assert found == expected
    assert peer.lost == lost
    assert peer.counts == {kind: expected.count(kind) for kind in Arrival}


def test_another_sender_is_foreign_until_the_first_is_silent():
    _, peer = judged((5, 100.0, 5.0))
    stranger = frame(0, 0.0, sender=99)
    assert peer.classify(stranger, 5.9) is FOREIGN
    assert peer.restarts == 0
    assert peer.silent(6.1)
    assert peer.classify(stranger, 6.1) is FRESH
    assert peer.restarts == 1
    assert peer.classify(frame(6, 101.0), 6.2) is FOREIGN


def test_late_frames_do_not_keep_the_peer_alive():
    _, peer = judged((0, 100.0, 5.0))
    for n in range(1, 40):
        assert peer.classify(frame(n, 100.0 + 0.1 * n), 5.0 + 3.5 + 0.1 * n) is LATE
    assert peer.silent(9.0)


def test_clock_offset_is_estimated_through_a_jittery_network():
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


def test_drifting_clock_is_followed_within_seconds():
    clocks = ClockOffset()
    for t0_s in np.arange(0.0, 10.0, 0.02):
        offset_s = 0.0 if t0_s < 5.0 else 0.5
        clocks.update(t0_s, t0_s + 0.01 + offset_s, t0_s + 0.01 + offset_s, t0_s + 0.02)
    assert clocks.best is not None
    assert clocks.best.offset_s == pytest.approx(0.5)


@pytest.mark.parametrize("stamps", [(nan, 1.0, 2.0, 3.0), (1.0, 2.0, 9.0, 3.0), (5.0, 2.0, 2.0, 3.0)])
def test_contradictory_stamps_are_left_out(stamps):
    clocks = ClockOffset()
    clocks.update(*stamps)
    assert clocks.best is None


def test_ages_are_on_the_own_clock():
    peer = Peer()
    assert peer.age_s(5.0) != peer.age_s(5.0)
    peer.classify(frame(0, 105.02, heard_sent_s=5.0, heard_at_s=105.01), 5.03)
    assert peer.offset is not None
    assert peer.offset.offset_s == pytest.approx(100.0)
    assert peer.age_s(6.0) == pytest.approx(0.98)
    assert peer.since_s(104.0, 6.0) == pytest.approx(2.0)


RNG = np.random.default_rng(4)


def pressed(
    monitor: MismatchMonitor, place: str, real_n_m: float, model_n_m: float, noise_n: float = 0.02
) -> None:
    for depth_m in np.linspace(0.002, 0.012, 60):
        measured_n = real_n_m * depth_m + RNG.normal(0.0, noise_n)
        monitor.add(place, depth_m, measured_n, model_n_m * depth_m)


def test_harder_place_is_reported_with_depth_and_size():
    monitor = MismatchMonitor(noise_n=0.02)
    pressed(monitor, "hold", 500.0, 500.0)
    pressed(monitor, "loading", 500.0, 490.0)
    assert monitor.mismatches() == []
    monitor = MismatchMonitor(noise_n=0.02)
    pressed(monitor, "soft", 500.0, 500.0)
    pressed(monitor, "hard", 1000.0, 500.0)
    (misfit,) = monitor.mismatches()
    assert misfit.place == "hard"
    assert misfit.summary().startswith("at depths of 2.0 to 12.0 mm, the virtual object is")
    assert 40.0 < 100.0 * misfit.share < 60.0
    assert "softer" in misfit.summary()


def test_noise_is_no_disagreement_and_the_worst_comes_first():
    monitor = MismatchMonitor(noise_n=0.5)
    pressed(monitor, "hold", 100.0, 100.0, noise_n=0.5)
    assert monitor.mismatches() == []
    monitor = MismatchMonitor()
    pressed(monitor, "worse", 2000.0, 500.0)
    pressed(monitor, "bad", 1000.0, 500.0)
    assert [misfit.place for misfit in monitor.mismatches()] == ["worse", "bad"]
    other = MismatchMonitor()
    pressed(other, "stiff model", 500.0, 1000.0)
    assert "stiffer" in other.mismatches()[0].summary()


def test_tip_follows_the_hand_and_the_tool_points_down():
    robot_file = load_robot_file(ARMS / "leader" / "leader.yaml")
    body = RigidBody.of_robot(robot_file)
    axis, down = np.array(robot_file.sensor_axis_tip), np.array((0.0, 0.0, -1.0))
    arm = VirtualArm(body, axis, down, np.array(robot_file.home_rad))
    before_rad = arm.position_rad
    for x_m in np.linspace(0.30, 0.45, 40):
        hand = np.array((x_m, 0.0, 0.1))
        arm.follow(hand)
        tip, rotation = body.tip_pose(arm.position_rad)
        np.testing.assert_allclose(tip, hand, atol=1e-9)
        np.testing.assert_allclose(rotation @ axis, down, atol=1e-9)
        assert arm.reached
    assert np.abs(arm.position_rad - before_rad).max() < 1.5  # no turns, and the elbow stays where it was
    there_rad = arm.position_rad
    arm.follow(np.array((3.0, 0.0, 0.1)))
    assert not arm.reached
    np.testing.assert_array_equal(arm.position_rad, there_rad)
