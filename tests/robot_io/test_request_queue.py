"""Answers without request ids are dated by their requests despite delays and losses."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from palpate.robot_io.drivers.joint_bus import RequestQueue

TICK_S, MARGIN_S, LATEST_S = 1e-3, 0.5e-3, 0.05


class RequestLine:
    """A device that is asked once a tick, and answers `delay_s(tick)` later in the order of the requests.

    Attributes:
        asked: Ticks in which it was asked.
        dates: For each tick, when its newest trusted answer was asked for: as dated, and in truth [s].
    """

    def __init__(self, ticks, delay_s, lost=()):
        self.queue, self.dates, self.asked = RequestQueue(MARGIN_S, LATEST_S), [], []
        coming, newest_s, dated_s, true_s = [], None, None, None
        for tick in range(ticks):
            now_s = tick * TICK_S
            while coming and coming[0][0] <= now_s:
                arrived_s, newest_s = coming.pop(0)
                assert self.queue.answer(arrived_s)
            if not self.queue.is_unsure and newest_s is not None:
                dated_s, true_s = self.queue.answered_s, newest_s
            self.dates.append((dated_s, true_s))
            if self.queue.omit_next():
                continue
            self.queue.ask(now_s)
            self.asked.append(tick)
            if tick not in lost:
                after_last_s = coming[-1][0] if coming else 0.0
                coming.append((max(now_s + delay_s(tick), after_last_s), now_s))


@pytest.mark.parametrize("delay_ms", [0.0, 0.4, 1.4, 4.2, 30.0])
@pytest.mark.parametrize("from_tick", [0, 50])
def test_late_answers_are_as_old_as_their_requests(delay_ms, from_tick):
    line = RequestLine(200, lambda tick: 1e-3 * delay_ms if tick >= from_tick else 0.3e-3)
    assert all(dated_s == true_s for dated_s, true_s in line.dates)
    assert line.dates[-1][1] >= (198 - delay_ms) * TICK_S
    assert len(line.asked) >= 197  # one is left out while a delay is not yet told from a loss


@pytest.mark.parametrize("delay_ms", [0.0, 0.4, 0.8, 1.4, 2.4])
def test_answers_are_dated_correctly_soon_after_a_loss(delay_ms):
    line = RequestLine(100, lambda tick: 1e-3 * delay_ms, lost=[50])
    assert all(dated_s == true_s for dated_s, true_s in line.dates)
    ages_s = [tick * TICK_S - true_s for tick, (_, true_s) in enumerate(line.dates) if true_s is not None]
    assert max(ages_s) <= (4 + 2 * delay_ms) * TICK_S
    assert max(ages_s[60:]) <= (1 + delay_ms) * TICK_S + 1e-9
    assert len(line.asked) >= 98  # one is left out, and one where the delay shows first


@given(st.floats(0.0, 3e-3), st.floats(0.0, 0.4e-3), st.sets(st.integers(20, 99), max_size=9))
@example(0.0, 0.0, {50, 51})
@example(0.8e-3, 0.0, {50})
@example(1.4e-3, 0.0, {50, 51, 52})
def test_losses_never_date_an_answer_too_new(delay_s, jitter_s, lost):
    line = RequestLine(150, lambda tick: delay_s + jitter_s * (tick % 3) / 2, lost)
    assert all(dated_s <= true_s for dated_s, true_s in line.dates if dated_s is not None)


@given(st.floats(0.0, 6e-3), st.floats(0.0, 6e-3), st.integers(20, 60), st.integers(-8, 8))
@example(3.44e-3, 5.379e-3, 57, -2)
@example(1.022e-3, 3.72e-3, 53, -2)
@example(0.2e-3, 1.7e-3, 30, 1)
def test_loss_beside_a_delay_change_dates_no_answer_too_new(before_s, after_s, from_tick, beside):
    delays_s = before_s, after_s
    line = RequestLine(150, lambda tick: delays_s[tick >= from_tick], {from_tick + beside})
    assert all(dated_s <= true_s for dated_s, true_s in line.dates if dated_s is not None)


@given(
    st.floats(0.0, 6e-3), st.floats(0.0, 6e-3), st.sets(st.integers(0, 149), max_size=6), st.integers(20, 60)
)
def test_no_answer_is_dated_later_than_its_request(before_s, after_s, lost, from_tick):
    """A delay that changes once, and answers that are lost, but where a loss and a change come together."""
    lost = {tick for tick in lost if not from_tick - 20 <= tick <= from_tick + 30}
    line = RequestLine(150, lambda tick: after_s if tick >= from_tick else before_s, lost)
    assert all(dated_s <= true_s for dated_s, true_s in line.dates if dated_s is not None)


def test_unsolicited_answer_is_ignored():
    queue = RequestQueue(MARGIN_S, LATEST_S)
    assert not queue.answer(1.0)
    queue.ask(1.0)
    assert queue.answer(1.001)
    assert queue.answered_s == 1.0
    assert not queue.answer(1.001)
    queue.ask(2.0)
    assert not queue.answer(2.0 + LATEST_S + 1e-6)  # so late that it is no answer to this


@pytest.mark.parametrize(("delay_s", "is_unsure"), [(2.25e-3, False), (2.35e-3, True)])
def test_usual_delay_follows_a_shorter_one_by_a_twentieth_per_answer(delay_s, is_unsure):
    """From 3 ms to 1.80 ms by ten answers without delay; the margin is 0.5 ms."""
    queue = RequestQueue(MARGIN_S, LATEST_S)
    for number, each_s in enumerate((3e-3, *10 * (0.0,))):
        queue.ask(number)
        assert queue.answer(number + each_s)
    queue.ask(20.0)
    queue.ask(20.001)
    assert queue.answer(20.0 + delay_s)
    assert queue.is_unsure is is_unsure


@pytest.mark.parametrize("lost", [(), (50,)])
def test_longer_delay_is_usual_after_four_unresolved_doubts(lost):
    """Delays of 5 and 8 ms in turn, which no number of lost answers explains; an earlier loss is none."""
    queue, doubted = RequestLine(100, lambda tick: 0.0, lost).queue, []
    for second in range(1, 7):
        queue.ask(second)
        queue.ask(second + 1e-3)
        assert queue.answer(second + 5e-3)
        doubted.append(queue.is_unsure)
        assert queue.answer(second + 9e-3)
        assert not queue.is_unsure
    assert doubted == 4 * [True] + 2 * [False]
