"""Loadstar's lines: what the manual shows, in any portions, and nothing else."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_io.drivers.serial_force import gauges
from robot_io.drivers.serial_force.gauges import loadstar_stream
from robot_io.drivers.serial_force.stream import newtons_per
from robot_io.errors import ProtocolError

POUND_N = 4.4482216152605  # NIST SP 811, lbf


@pytest.mark.parametrize(
    ("text", "value"), [("3.04", 3.04), ("-0.000456", -0.000456), ("      3.0400", 3.04)]
)
def test_readings_of_the_manual(text, value):
    """The command set's examples, and the %12.4f of the fast interface."""
    assert gauges.number_of(text) == value


@pytest.mark.parametrize("text", ["", "nan", "inf", "1e5", "1.2.3", "0x10", "--1", "1,5", "1 2", "٣"])
def test_what_is_no_reading_is_refused(text):
    with pytest.raises(ProtocolError):
        gauges.number_of(text)


def test_answers_of_the_manual():
    assert gauges.model_of("FCM DI-1000") == "DI-1000"
    assert gauges.model_of("FCM DI-100") == "DI-100"
    assert gauges.unit_of("lbf") == pytest.approx(POUND_N)
    assert gauges.unit_of("UNITS kgf") == pytest.approx(9.80665)
    for unit in ("lbf-ft", "in", "psi", "", "UNITS", "MN"):
        with pytest.raises(ProtocolError, match="not a known unit"):
            gauges.unit_of(unit)
    with pytest.raises(ProtocolError, match="iLoad"):
        gauges.model_of("iLoad Pro")


@pytest.mark.parametrize(
    ("unit", "newtons"), [("N", 1), ("kN", 1e3), ("mN", 1e-3), ("oz", POUND_N / 16), ("gf", 9.80665e-3)]
)
def test_units(unit, newtons):
    assert newtons_per(unit) == pytest.approx(newtons)


@given(st.lists(st.floats(-150, 150), max_size=20), st.data())
def test_any_portions_give_the_same_readings(values, data):
    text = "\r\n" + "".join(f"{value:12.4f}\r\n" for value in values)
    stream, samples, rest = loadstar_stream(1.0, 100.0), [], text.encode()
    while rest:
        cut = data.draw(st.integers(1, len(rest)))
        samples += stream.feed(rest[:cut])
        rest = rest[cut:]
    assert samples == [float(f"{value:.4f}") for value in values]
    assert stream.rejected == 0


def test_what_was_not_seen_from_its_beginning_is_no_reading():
    """The last digits of 123.4567 would be a fine number."""
    assert loadstar_stream(1.0, 100.0).feed(b"4567\r\n   1.0000\r\n") == [1.0]


def test_more_than_the_sensor_can_feel_is_no_reading():
    stream = loadstar_stream(1.0, 100.0)
    assert stream.feed(b"\r\n  201.0000\r\n  199.0000\r\n") == [199.0]
    assert stream.rejected == 1


def test_an_endless_line_takes_no_memory():
    stream = loadstar_stream(1.0, 100.0)
    for _ in range(1000):
        assert stream.feed(b"1" * 100) == []
    assert stream.feed(b"\r\n   2.0000\r\n") == [2.0]
    assert stream.rejected == 1000 // 3  # of more than 256 bytes each
