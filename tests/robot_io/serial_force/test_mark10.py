"""Mark-10's readings: what the manual shows, in their own unit, and nothing else."""

import pytest

from robot_io.drivers.serial_force.gauges import Mark10Stream, reading_of
from robot_io.drivers.serial_force.stream import Poll
from robot_io.errors import ProtocolError

POUND_N = 4.4482216152605  # NIST SP 811, lbf


def gauge_stream(unit, capacity_n):
    return Mark10Stream(unit, capacity_n, "M7-50", Poll(b"?", b"!"))


def test_readings_of_the_manual():
    """Series 4 and 5 user's guides: tension, compression."""
    assert reading_of("-18.78 lbF") == ("-18.78", "lbF")
    stream = gauge_stream("lbF", 1000.0)
    assert stream.feed(b"-18.78 lbF\r\n4.285 lbF\r\n") == pytest.approx([-18.78 * POUND_N, 4.285 * POUND_N])
    assert gauge_stream("mN", 10.0).feed(b"500 mN\r\n") == pytest.approx([0.5])


@pytest.mark.parametrize("line", ["", "1.5", "1.5lbF", "1,5 N", "nan N", "1e3 N", "*10", "1 N x", "-- N"])
def test_what_is_no_reading_is_refused(line):
    with pytest.raises(ProtocolError):
        reading_of(line)


@pytest.mark.parametrize("unit", ["lbFin", "Nm", "COF", "MN"])
def test_a_unit_that_is_none_of_force_is_named(unit):
    with pytest.raises(ProtocolError, match=f"unit '{unit}' is not a known unit of force"):
        gauge_stream(unit, 100.0)


def test_another_unit_is_no_reading_and_named_once_it_is_no_damage():
    stream = gauge_stream("N", 100.0)
    assert stream.feed(b"1.00 N\r\n1.00 n\r\n1.00 M\r\n") == [1.0]
    assert (stream.rejected, stream.complaint) == (2, "")
    assert stream.feed(b"0.22 lbF\r\n0.22 lbF\r\n") == []
    assert stream.complaint == "the gauge reads in lbF, and read in N when it was configured"
    assert stream.feed(b"1.00 N\r\n") == [1.0]
    assert not stream.complaint
    stream.feed(b"*22\r\n")
    assert stream.complaint == "the gauge says '*22 value too large'"


def test_one_question_is_out_at_a_time():
    poll = Poll(b"?", b"!")
    assert [poll.to_send(time_s) for time_s in (0.0, 0.01)] == [b"?", b""]
    assert poll.answered(0.011) == 0.0
    assert poll.answered(0.012) is None  # nobody asked for this one
    assert poll.to_send(0.02) == b"?"


def test_an_answer_that_does_not_come_is_not_taken_for_the_next_one():
    poll = Poll(b"?", b"!")
    asked = [time_s / 1e3 for time_s in range(1000) if poll.to_send(time_s / 1e3)]
    assert asked[1] >= 0.1 + 0.25
    fresh = Poll(b"?", b"!")
    fresh.to_send(0.0)
    assert fresh.to_send(0.15) == b""
    assert fresh.answered(0.16) is None  # too late


def used_poll():
    """A poll whose answers take 1.6 ms; the last question is from 2.0 s on."""
    poll = Poll(b"?", b"!")
    for tick in range(500):
        assert poll.to_send(4e-3 * tick) == b"?"
        assert poll.answered(4e-3 * tick + 1.6e-3) == 4e-3 * tick
    assert poll.to_send(2.0) == b"?"
    return poll


def test_after_a_lost_answer_the_next_question_comes_at_once_behind_a_marker():
    poll = used_poll()
    assert [poll.to_send(2.0 + 1e-3 * tick) for tick in range(1, 6)] == [b"", b"", b"!?", b"", b""]
    assert poll.answered(2.0045) is None  # a late answer to the question before
    poll.marked()
    assert poll.answered(2.006) == 2.003


def test_where_the_marker_is_not_answered_either_the_gauge_is_left_alone():
    poll = used_poll()
    sent = {tick: poll.to_send(2.0 + 1e-3 * tick) for tick in range(1, 353)}
    assert [tick for tick, data in sent.items() if data] == [3, 350]
    assert poll.answered(2.352) == pytest.approx(2.35)


def test_what_is_before_the_marker_s_answer_is_no_reading():
    poll = used_poll()
    stream = Mark10Stream("N", 100.0, "M7-50", poll)
    assert stream.feed(b"1.00 N\r\nM7-50\r\n3.00 N\r\n") == [3.0]
    assert poll.to_send(2.004) == b"!?"
    assert stream.feed(b"4.00 NM7-50\r\n5.00 N\r\n") == [5.0]  # a reading has lost its end
    assert poll.answered(2.006) == 2.004
