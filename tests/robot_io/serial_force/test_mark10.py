"""Mark-10's readings: what the manual shows, in their own unit, and nothing else."""

import pytest

from robot_io.drivers.serial_force.mark10 import Mark10Stream, reading_of
from robot_io.drivers.serial_force.poll import Poll
from robot_io.errors import ProtocolError

POUND_N = 4.4482216152605  # NIST SP 811, lbf


def test_readings_of_the_manual():
    """Series 4 and 5 user's guides: tension, compression."""
    assert reading_of("-18.78 lbF") == ("-18.78", "lbF")
    stream = Mark10Stream("lbF", 1000.0)
    assert stream.feed(b"-18.78 lbF\r\n4.285 lbF\r\n") == pytest.approx([-18.78 * POUND_N, 4.285 * POUND_N])
    assert Mark10Stream("mN", 10.0).feed(b"500 mN\r\n") == pytest.approx([0.5])


@pytest.mark.parametrize("line", ["", "1.5", "1.5lbF", "1,5 N", "nan N", "1e3 N", "*10", "1 N x", "-- N"])
def test_what_is_no_reading_is_refused(line):
    with pytest.raises(ProtocolError):
        reading_of(line)


@pytest.mark.parametrize("unit", ["lbFin", "Nm", "COF", "MN"])
def test_a_unit_that_is_none_of_force_is_named(unit):
    with pytest.raises(ProtocolError, match=f"unit '{unit}' is not a known unit of force"):
        Mark10Stream(unit, 100.0)


def test_another_unit_is_no_reading_and_named_once_it_is_no_damage():
    stream = Mark10Stream("N", 100.0)
    assert stream.feed(b"1.00 N\r\n1.00 n\r\n1.00 M\r\n") == [1.0]
    assert (stream.rejected, stream.complaint) == (2, "")
    assert stream.feed(b"0.22 lbF\r\n0.22 lbF\r\n") == []
    assert stream.complaint == "the gauge reads in lbF, and read in N when it was configured"
    assert stream.feed(b"1.00 N\r\n") == [1.0]
    assert not stream.complaint
    stream.feed(b"*22\r\n")
    assert stream.complaint == "the gauge says '*22 value too large'"


def test_one_question_is_out_at_a_time():
    poll = Poll(b"?")
    assert [poll.to_send(time_s) for time_s in (0.0, 0.01)] == [b"?", b""]
    assert poll.answered() == 0.0
    assert poll.answered() is None  # nobody asked for this one
    assert poll.to_send(0.02) == b"?"


def test_an_answer_that_does_not_come_is_not_taken_for_the_next_one():
    poll = Poll(b"?")
    asked = [time_s / 1e3 for time_s in range(1000) if poll.to_send(time_s / 1e3)]
    assert asked[1] >= 0.1 + 0.25
    fresh = Poll(b"?")
    fresh.to_send(0.0)
    assert fresh.to_send(0.15) == b""
    assert fresh.answered() is None  # too late
