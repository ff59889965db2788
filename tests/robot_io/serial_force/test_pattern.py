"""Force sensors that write lines: the generic parser, Loadstar and Mark-10."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.drivers.serial_force import gauges
from palpate.robot_io.drivers.serial_force.gauges import (
    Mark10Stream,
    compile_pattern,
    loadstar_stream,
    parse_reading,
    pattern_stream,
)
from palpate.robot_io.drivers.serial_force.stream import Poll, newtons_per
from palpate.robot_io.errors import InputError, ProtocolError

MARK_10 = r"\s*(?P<value>[-+]?[\d.]+) (?P<unit>\w+)"
LBF_N = 4.4482216152605  # NIST SP 811
OPEN_SCALE = r"\d+,(?P<value>[-\d.]+),(?P<unit>lbs|kg),.*"


def stream(pattern, unit=None, scale=1.0):
    return pattern_stream(pattern, unit, scale)


def forces_n(pattern, line, **settings):
    """What is made of one line."""
    return stream(pattern, **settings).feed(b"\n" + line.encode() + b"\n")


@pytest.mark.parametrize(
    ("pattern", "line", "settings", "force_n"),
    [
        (MARK_10, "12.50 N", {}, 12.5),
        (MARK_10, " -2.0 lbF", {}, -2 * LBF_N),
        *(
            (MARK_10, f"1 {unit}", {}, value)
            for unit, value in {"kN": 1e3, "mN": 1e-3, "gf": 9.80665e-3}.items()
        ),
        (MARK_10, "1 oz", {}, LBF_N / 16),
        (MARK_10, "3 mN", {"unit": "kN"}, 3e-3),  # the unit in the line counts
        (OPEN_SCALE, "1234,-2.5,lbs,0,", {}, -2.5 * LBF_N),
        (r"(?P<value>-?\d+)", "250", {"unit": "N", "scale": -0.01}, -2.5),
    ],
)
def test_value_and_unit_are_parsed(pattern, line, settings, force_n):
    assert forces_n(pattern, line, **settings) == pytest.approx([force_n])


@pytest.mark.parametrize("line", ["12.5", "12.5 N extra", "abc", "1.2.3 N", "5 psi", ". N"])
def test_line_that_does_not_fit_is_refused(line):
    assert forces_n(MARK_10, line) == []
    assert forces_n(r"(?P<value>\d+)", "5") == []  # without any unit nothing is guessed


def test_bad_lines_are_counted_and_left_out():
    gauge = stream(MARK_10)
    assert gauge.feed(b"half\r\n1.0 N\r\nnoise\r\n\xff\xfe N\r\n2.0 N\r\n3.") == [1.0, 2.0]
    assert gauge.rejected == 2
    assert gauge.feed(b"5 N\n") == [3.5]


@pytest.mark.parametrize(("equal", "forces"), [(200, [2.5]), (201, [])])
def test_other_decimals_after_many_equal_ones_are_damage_until_they_last(equal, forces):
    gauge = stream(MARK_10)
    assert len(gauge.feed(b"\n" + equal * b"1.25 N\n")) == equal
    assert gauge.feed(b"2.5 N\n") == forces
    assert gauge.feed(b"2.5 N\n") == [2.5]


@pytest.mark.parametrize(
    ("pattern", "problem"),
    [
        (r"(\d+)", "no group"),
        (r"(?P<value>", "pattern"),
        (r"(?P<value>(a+)+)", "may never end"),
        (r"(?P<value>a)|(b|b)*", "may never end"),
        # A line of noise would stall the control loop for 0.1 s, 0.3 s, and hours.
        (r"\s*\w*\s*(?P<value>[-+]?\d*\.?\d+)\s*(?P<unit>[a-zA-Z]+)\s*.*", "'111...', takes [0-9]+ ms"),
        (r".*(?P<value>\d+).*,.*,.*,.*;", "takes [0-9]+ ms"),
        (".*" * 12 + r"(?P<value>1)x", "takes [0-9]+ ms"),
    ],
)
def test_unusable_pattern_is_refused(pattern, problem):
    with pytest.raises(InputError, match=problem):
        compile_pattern(pattern)


@pytest.mark.parametrize(
    ("text", "value"), [("3.04", 3.04), ("-0.000456", -0.000456), ("      3.0400", 3.04)]
)
def test_readings_of_the_manual(text, value):
    """The command set's examples, and the %12.4f of the fast interface."""
    assert gauges.parse_number(text) == value


@pytest.mark.parametrize("text", ["", "nan", "inf", "1e5", "1.2.3", "0x10", "--1", "1,5", "1 2", "٣"])
def test_invalid_reading_is_refused(text):
    with pytest.raises(ProtocolError):
        gauges.parse_number(text)


def test_answers_of_the_manual():
    assert gauges.parse_model("FCM DI-1000") == "DI-1000"
    assert gauges.parse_model("FCM DI-100") == "DI-100"
    assert newtons_per("lbf") == pytest.approx(LBF_N)
    assert newtons_per("kgf") == pytest.approx(9.80665)
    for unit in ("lbf-ft", "in", "psi", "", "UNITS", "MN"):
        with pytest.raises(ProtocolError, match="not a known unit"):
            newtons_per(unit)
    with pytest.raises(ProtocolError, match="iLoad"):
        gauges.parse_model("iLoad Pro")


@given(st.lists(st.floats(-150, 150), max_size=20), st.data())
def test_readings_are_parsed_from_any_chunks(values, data):
    text = "\r\n" + "".join(f"{value:12.4f}\r\n" for value in values)
    stream, samples, rest = loadstar_stream(1.0, 100.0), [], text.encode()
    while rest:
        cut = data.draw(st.integers(1, len(rest)))
        samples += stream.feed(rest[:cut])
        rest = rest[cut:]
    assert samples == [float(f"{value:.4f}") for value in values]
    assert stream.rejected == 0


def test_truncated_and_oversized_lines_are_no_readings():
    """The last digits of 123.4567 would be a fine number."""
    assert loadstar_stream(1.0, 100.0).feed(b"4567\r\n   1.0000\r\n") == [1.0]
    stream = loadstar_stream(1.0, 100.0)
    assert stream.feed(b"\r\n  201.0000\r\n  199.0000\r\n") == [199.0]
    assert stream.rejected == 1
    stream = loadstar_stream(1.0, 100.0)
    for _ in range(1000):
        assert stream.feed(b"1" * 100) == []
    assert stream.feed(b"\r\n   2.0000\r\n") == [2.0]
    assert stream.rejected == 1000 // 3  # of more than 256 bytes each


def gauge_stream(unit, capacity_n):
    return Mark10Stream(unit, capacity_n, "M7-50", Poll(b"?", b"!"))


def test_readings_of_mark10_s_manual():
    """Series 4 and 5 user's guides: tension, compression."""
    assert parse_reading("-18.78 lbF") == ("-18.78", "lbF")
    stream = gauge_stream("lbF", 1000.0)
    assert stream.feed(b"-18.78 lbF\r\n4.285 lbF\r\n") == pytest.approx([-18.78 * LBF_N, 4.285 * LBF_N])
    assert gauge_stream("mN", 10.0).feed(b"500 mN\r\n") == pytest.approx([0.5])


@pytest.mark.parametrize("line", ["", "1.5", "1.5lbF", "1,5 N", "nan N", "1e3 N", "*10", "1 N x", "-- N"])
def test_invalid_mark10_line_is_refused(line):
    with pytest.raises(ProtocolError):
        parse_reading(line)


@pytest.mark.parametrize("unit", ["lbFin", "Nm", "COF", "MN"])
def test_unit_that_is_no_force_is_named(unit):
    with pytest.raises(ProtocolError, match=f"unit '{unit}' is not a known unit of force"):
        gauge_stream(unit, 100.0)


def test_another_unit_is_no_reading_and_is_named_when_repeated():
    stream = gauge_stream("N", 100.0)
    assert stream.feed(b"1.00 N\r\n1.00 n\r\n1.00 M\r\n") == [1.0]
    assert (stream.rejected, stream.fault_text) == (2, "")
    assert stream.feed(b"0.22 lbF\r\n0.22 lbF\r\n") == []
    assert stream.fault_text == "the gauge reads in lbF; when configured, it read in N"
    assert stream.feed(b"1.00 N\r\n") == [1.0]
    assert not stream.fault_text
    stream.feed(b"*22\r\n")
    assert stream.fault_text == "the gauge says '*22 value too large'"


def test_one_request_is_pending_and_late_answers_are_discarded():
    poll = Poll(b"?", b"!")
    assert [poll.to_send(time_s) for time_s in (0.0, 0.01)] == [b"?", b""]
    assert poll.answered(0.011) == 0.0
    assert poll.answered(0.012) is None  # nobody asked for this one
    assert poll.to_send(0.02) == b"?"
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


def test_answer_may_take_as_long_as_one_of_the_last():
    poll = Poll(b"?", b"!")
    for asked_s, delay_s in ((0.0, 5e-3), (0.01, 1e-3)):
        assert poll.to_send(asked_s) == b"?"
        assert poll.answered(asked_s + delay_s) == asked_s
    assert [poll.to_send(time_s) for time_s in (0.02, 0.025, 0.0265)] == [b"?", b"", b"!?"]


def test_usual_answering_time_follows_a_shorter_one_by_a_hundredth():
    """From 5 ms to 2.46 ms by a hundred answers after 1 ms; a marker is sent 1 ms later."""
    poll = Poll(b"?", b"!")
    for number in range(101):
        assert poll.to_send(0.01 * number) == b"?"
        assert poll.answered(0.01 * number + (1e-3 if number else 5e-3)) == 0.01 * number
    assert [poll.to_send(2.0 + 1e-3 * after_ms) for after_ms in (0.0, 3.4, 3.5)] == [b"?", b"", b"!?"]


def test_request_after_a_lost_answer_has_a_marker():
    poll = used_poll()
    assert [poll.to_send(2.0 + 1e-3 * tick) for tick in range(1, 6)] == [b"", b"", b"!?", b"", b""]
    assert poll.answered(2.0045) is None  # a late answer to the question before
    poll.marked()
    assert poll.answered(2.006) == 2.003
    poll = used_poll()
    sent = {tick: poll.to_send(2.0 + 1e-3 * tick) for tick in range(1, 353)}
    assert [tick for tick, data in sent.items() if data] == [3, 350]
    assert poll.answered(2.352) == pytest.approx(2.35)
    poll = used_poll()
    stream = Mark10Stream("N", 100.0, "M7-50", poll)
    assert stream.feed(b"1.00 N\r\nM7-50\r\n3.00 N\r\n") == [3.0]
    assert poll.to_send(2.004) == b"!?"
    assert stream.feed(b"4.00 NM7-50\r\n5.00 N\r\n") == [5.0]  # a reading has lost its end
    assert poll.answered(2.006) == 2.004
