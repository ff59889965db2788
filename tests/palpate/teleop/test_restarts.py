"""Restart of one side: numbers begin anew, and old messages are ignored."""

from types import SimpleNamespace

import numpy as np
import pytest

from palpate.robot_io.link.frame import LastReceived, decode, encode
from palpate.robot_io.link.messages import ObjectEstimate, TargetState, target_number
from palpate.sim_backend.scenario import load_scenario
from palpate.teleop import follower, leader
from palpate.teleop.estimating import sample_stream
from palpate.teleop.haptics import _NOTHING
from tests.robot_io.link.link_parts import estimate, intent, report, target

LATER_S = 5.0  # by then a side that says nothing is gone


class StoredLine:
    """A line whose frames are given, at a time of the test's choosing."""

    def __init__(self):
        self.arrived, self.sent, self.anew, self.malformed, self.now, self.sender = [], [], [], 0, 0.0, 77

    def put(self, sender, sequence, message, answers=None):
        heard = LastReceived(self.sender if answers is None else answers)
        self.arrived.append((self.now, decode(encode(sender, sequence, self.now, heard, message))))

    def receive(self):
        arrived, self.arrived = self.arrived, []
        return arrived

    def heard(self, frame, at_s):
        pass

    def send(self, message):
        self.sent.append(message)

    def resubscribe(self):
        self.anew.append(self.now)

    def now_s(self):
        return self.now


def sent_estimates(line):
    return [(sent.target, sent.revision) for sent in line.sent if isinstance(sent, ObjectEstimate)]


@pytest.fixture
def line():
    return StoredLine()


@pytest.fixture
def led(line):
    ignore = [].append
    return leader._Leader(load_scenario("default"), line, line, None, None, ignore, ignore)


@pytest.fixture
def followed(line, monkeypatch):
    answers = []
    fake = SimpleNamespace(answers=lambda: [answers.pop(0)] if answers else [], busy=False)
    monkeypatch.setattr(follower, "ObjectEstimator", lambda *, diagnose: fake)
    return follower.FollowerMessaging(line, line, [].append, diagnose=True), answers


def test_target_states_of_an_earlier_leader_are_ignored(led, line):
    last = [target_number(5, count) for count in (0, 1)]
    line.put(1, 0, report(targets=tuple(last), states=(TargetState.DONE, TargetState.REFUSED)))
    led._exchange()
    led._select((0.4, 0.0, 0.05))
    led._exchange()
    (queued,) = line.sent[-1].targets
    assert queued.number not in last


def test_estimates_of_a_restarted_follower_are_taken(led, line):
    line.put(1, 0, estimate(revision=7))
    led._exchange()
    assert line.sent[-1].seen == (7,)
    line.now += LATER_S
    again = estimate(revision=0, rmse_n=0.5)
    line.put(2, 0, again)
    led._exchange()
    assert line.sent[-1].seen == (0,)
    assert led._target_states.choose((0.4, 0.0, 0.05)) == again


@pytest.mark.parametrize("answers", [0, 78])
def test_messages_from_an_unacknowledged_peer_are_ignored(followed, line, answers):
    """It may be what somebody recorded on another day, with the pair's own key."""
    messaging, _ = followed
    line.put(1, 0, intent(target(0)), answers=answers)
    messaging._exchange()
    assert messaging.queue.states() == {}
    line.put(1, 1, intent(target(0)))
    messaging._exchange()
    assert messaging.queue.states() == {0: TargetState.QUEUED}


def test_silent_side_repeats_its_presence(led, line):
    for now_s in np.arange(0.0, 11.0, 0.5):
        line.now = now_s
        if 3.5 < now_s < 7.0:
            line.put(1, int(2.0 * now_s), report())
        led._exchange()
    assert line.anew == [3.0, 10.5]  # the last word, at 6.5 s, holds for a second


def test_possible_errors_are_reported_once(led, line):
    line.advice = "is it running?"
    led._exchange()
    led._report = _NOTHING  # after a start of 20 s
    for now_s in (20.0, 29.0):
        line.now = now_s
        led._exchange()
    assert not led._notes
    for now_s in (30.0, 31.0):
        line.now = now_s
        led._exchange()
    assert [text for _, text in led._notes] == ["no message arrived for 10 s: is it running?"]
    line.malformed, line.refused = 3, "another key"
    for _ in range(2):
        led._exchange()
    assert [text for _, text in led._notes[1:]] == ["a frame was refused: another key"]


def test_targets_that_a_follower_left_are_unfinished(led, line):
    for x_m in (0.36, 0.40):
        led._select((x_m, 0.0, 0.05))
    done = TargetState.DONE, TargetState.QUEUED
    line.put(1, 0, report(targets=tuple(led._targets), states=tuple(map(int, done)), ended=True))
    led._exchange()
    assert led.outcome().states == {0: "done", 1: "queued"}
    assert led.outcome().unfinished == (1,)


def test_lost_estimate_is_sent_again_though_newer_ones_arrived(followed, line):
    messaging, answers = followed
    line.put(1, 0, intent())
    for place in (0, 1, 2):
        answers.append(estimate(target=place))
        messaging._exchange_estimates()
    line.put(1, 1, intent(seen=(0, 2)))  # revision 1 was lost
    messaging._exchange()
    assert sent_estimates(line) == [(1, 1)]
    line.put(1, 2, intent(seen=(0, 1, 2)))
    line.now += LATER_S / 10.0
    messaging._exchange()
    assert sent_estimates(line) == [(1, 1)]


def test_new_leader_receives_the_earlier_object_estimates(followed, line):
    messaging, answers = followed
    line.put(1, 0, intent(target(0)))
    messaging._exchange()
    answers.append(estimate(target=0, runs=6, verdict="adequate"))
    messaging._exchange_estimates()
    line.put(1, 1, intent(seen=(0,)))
    line.now += LATER_S
    line.put(2, 0, intent())
    messaging._exchange()
    answers.append(estimate(target=target_number(2, 0), runs=1, verdict=""))
    messaging._exchange_estimates()
    assert [one.runs for one in messaging._unseen()] == [6, 1]
    assert messaging.queue.states() == {}


def test_arm_waits_for_a_pending_estimate_at_every_moment(followed, line):
    """Whoever asks between two steps of the talking thread hears that something is still to come."""
    messaging, answers = followed
    asked, estimator = [], messaging._estimator

    def request(samples, target, *, last):
        asked.append(messaging.settled())
        answers.append(estimate(target=target))

    def answer():
        asked.append(messaging.settled())
        return [answers.pop(0)] if answers else []

    estimator.request, estimator.answers = request, answer
    assert messaging.settled()
    stream = sample_stream(3)
    messaging.samples.append((stream, np.zeros(2, stream.dtype), 0, True))
    assert not messaging.settled()
    messaging._exchange()
    assert asked == [False, False]
    assert messaging.settled()  # nobody is there to see it


def test_later_verdict_replaces_an_earlier_one_by_any_name(followed, line):
    messaging, answers = followed
    for verdict in ("incomplete", "adequate", ""):
        answers.append(estimate(runs=6, verdict=verdict))
        messaging._exchange_estimates()
    (kept,) = messaging._unseen()
    assert isinstance(kept, ObjectEstimate)
    assert kept.verdict == "adequate"
