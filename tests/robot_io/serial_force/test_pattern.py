"""The generic line parser."""

import pytest

from robot_io.drivers.serial_force.gauges import compile_pattern, pattern_stream
from robot_io.errors import InputError

MARK_10 = r"\s*(?P<value>[-+]?[\d.]+) (?P<unit>\w+)"
LBF_N = 4.4482216152605  # NIST SP 811
OPEN_SCALE = r"\d+,(?P<value>[-\d.]+),(?P<unit>lbs|kg),.*"


def stream(pattern, unit=None, scale=1.0):
    return pattern_stream(pattern, unit, scale, 1e9)


def forces_n(pattern, line, **settings):
    """What is made of one line."""
    return stream(pattern, **settings).feed(b"\n" + line.encode() + b"\n")


@pytest.mark.parametrize(
    ("pattern", "line", "settings", "force_n"),
    [
        (MARK_10, "12.50 N", {}, 12.5),
        (MARK_10, " -2.0 lbF", {}, -2 * LBF_N),
        (MARK_10, "3 mN", {"unit": "kN"}, 3e-3),  # the unit in the line counts
        (OPEN_SCALE, "1234,-2.5,lbs,0,", {}, -2.5 * LBF_N),
        (r"(?P<value>-?\d+)", "250", {"unit": "N", "scale": -0.01}, -2.5),
    ],
)
def test_value_and_unit(pattern, line, settings, force_n):
    assert forces_n(pattern, line, **settings) == pytest.approx([force_n])


@pytest.mark.parametrize("line", ["12.5", "12.5 N extra", "abc", "1.2.3 N", "5 psi", ". N"])
def test_what_does_not_fit_is_refused(line):
    assert forces_n(MARK_10, line) == []
    assert forces_n(r"(?P<value>\d+)", "5") == []  # without any unit nothing is guessed


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
