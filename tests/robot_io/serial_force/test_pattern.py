"""The generic line parser."""

import pytest

from robot_io.errors import InputError, ProtocolError
from robot_io.serial_force.pattern import PatternStream, compile_pattern

MARK_10 = r"\s*(?P<value>[-+]?[\d.]+) (?P<unit>\w+)"
OPEN_SCALE = r"\d+,(?P<value>[-\d.]+),lbs,.*"


def stream(pattern, unit=None, scale=1.0):
    return PatternStream(compile_pattern(pattern), unit, scale)


def test_the_unit_in_the_line_counts():
    assert stream(MARK_10).force_n("12.50 N") == 12.5
    assert stream(MARK_10).force_n(" -2.0 lbF") == pytest.approx(-2 * 4.4482216152605)
    assert stream(MARK_10, unit="kN").force_n("3 mN") == pytest.approx(3e-3)


def test_a_stated_unit_and_scale():
    assert stream(OPEN_SCALE, unit="lbf").force_n("1234,-2.5,lbs,0,") == pytest.approx(-2.5 * 4.4482216152605)
    assert stream(r"(?P<value>-?\d+)", unit="N", scale=-0.01).force_n("250") == pytest.approx(-2.5)


def test_without_any_unit_nothing_is_guessed():
    with pytest.raises(ProtocolError, match="no unit"):
        stream(r"(?P<value>\d+)").force_n("5")


@pytest.mark.parametrize("line", ["12.5", "12.5 N extra", "abc", "1.2.3 N", "5 psi", ". N"])
def test_what_does_not_fit_is_refused(line):
    with pytest.raises(ProtocolError):
        stream(MARK_10).force_n(line)


def test_bad_lines_are_counted_and_left_out():
    gauge = stream(MARK_10)
    assert gauge.feed(b"half\r\n1.0 N\r\nnoise\r\n\xff\xfe N\r\n2.0 N\r\n3.") == [1.0, 2.0]
    assert gauge.rejected == 2
    assert gauge.feed(b"5 N\n") == [3.5]


@pytest.mark.parametrize(
    ("pattern", "problem"),
    [
        (r"(\d+)", "no group"),
        (r"(?P<value>", "pattern"),
        (r"(?P<value>(a+)+)", "for ever"),
        (r"(?P<value>a)|(b|b)*", "for ever"),
    ],
)
def test_a_pattern_that_cannot_work_is_refused(pattern, problem):
    with pytest.raises(InputError, match=problem):
        compile_pattern(pattern)
