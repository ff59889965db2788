"""Whom one side of the link listens to."""

from math import nan
from types import SimpleNamespace

from control.teleop.messaging import Messaging
from robot_io.clock import SimulatedClock
from robot_io.link import Heard, Intent, decode, encode

US, PEER, OTHER = 1, 2, 3


def _frame(sender, names, sequence, sent_s):
    said = Intent((), (sequence,), (), ended=False)
    return decode(encode(sender, sequence, sent_s, Heard(names, nan, nan), said))


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


def test_who_has_heard_this_program_is_the_peer():
    side, line, clock = _side()
    line.inbox = [(10.0, _frame(PEER, 0, 0, 5.0))]
    side.receive()
    assert (side.linked, line.named, line.taken) == (False, [PEER], [])  # our next frame names it
    line.inbox = [(10.1, _frame(PEER, US, 1, 5.1))]
    clock.sleep_until(clock.now_s() + 0.1)
    side.receive()
    assert (side.linked, line.taken) == (True, [1])


def test_frames_recorded_on_another_day_neither_keep_a_link_alive_nor_take_the_peer_s_place():
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


def test_a_side_that_nobody_answers_is_told_that_somebody_else_is_answered():
    side, line, clock = _side()
    line.inbox = [(10.0, _frame(PEER, OTHER, 0, 5.0))]
    side.receive()
    clock.sleep_until(clock.now_s() + 11.0)
    assert "answers another program" in side.problem()
    assert not side.problem()
