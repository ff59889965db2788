"""Damaged data: readings after it are discarded, and a lost byte never gives a wrong force."""

import math
import os

import numpy as np
import pytest

from robot_io.clock import SimulatedClock
from robot_io.drivers.serial_force.gauges import loadstar_stream, pattern_stream
from robot_io.drivers.serial_force.line import SerialReader
from robot_io.drivers.serial_force.lorenz import LorenzStream


class ReadingLine:
    """A sensor's line without a sensor; each line arrives 1 ms after the one before."""

    def __init__(self):
        self._read, self._write = os.pipe()
        self.clock = SimulatedClock()
        self.reader = SerialReader(self._read, loadstar_stream(1.0, 1e3), self.clock, 1e3)
        self.send(b"")

    def send(self, text, ticks=1):
        """Send a line so many times; returns what is believed then, and how old it is in ms."""
        for _ in range(ticks):
            self.clock.sleep_until(self.clock.now_s() + 1e-3)
            os.write(self._write, text + b"\r\n")
            self.reader.look()
        newest = self.reader.newest
        return newest and (newest.force_n, round(1e3 * (self.clock.now_s() - newest.arrived_at_s)))

    def close(self):
        os.close(self._read)
        os.close(self._write)


@pytest.fixture
def line():
    made = ReadingLine()
    yield made
    made.close()


def test_two_readings_after_a_damaged_line_are_not_believed(line):
    assert line.send(b"1.0", 5) == (1.0, 0)
    assert line.send(b"1.\xb0") == (1.0, 1)
    assert line.send(b"9.0") == (1.0, 2)
    assert line.send(b"9.0") == (1.0, 3)
    assert line.send(b"2.0") == (2.0, 0)


def test_where_it_happens_again_soon_more_are_doubted(line):
    line.send(b"1.0", 5)
    line.send(b"?")
    line.send(b"?")
    assert line.send(b"2.0", 8) == (1.0, 10)
    assert line.send(b"3.0") == (3.0, 0)


def test_long_after_it_is_forgotten(line):
    line.send(b"1.0", 5)
    for _ in range(4):
        line.send(b"?")
        line.send(b"2.0", 200)
    line.send(b"?")
    assert line.send(b"3.0", 3) == (3.0, 0)


def test_a_line_that_goes_on_being_damaged_is_silent(line):
    """One in three looks like a reading, and is none."""
    line.send(b"1.0", 5)
    for k in range(300):
        believed = line.send(b"7.0" if k % 3 == 2 else b"4\x00", 1)
        assert believed == (1.0, k + 1)
    assert line.send(b"1.5", 1000) == (1.5, 0)


def test_readings_that_came_together_with_a_damaged_line_are_not_believed(line):
    line.send(b"1.0", 5)
    assert line.send(b"9.0\r\n?\r\n9.0\r\n9.0") == (1.0, 1)


def test_what_a_device_says_of_itself_before_its_first_reading_is_no_damage(line):
    for _ in range(8):
        assert line.send(b"load cell amplifier, version 2") is None
    assert line.send(b"1.0", 3) is None  # two are discarded, one waits for the next
    assert line.send(b"1.0") == (1.0, 0)


def test_a_reader_that_was_stopped_looks_no_more(line):
    """Its port may be somebody else's by now."""
    line.send(b"1.0", 5)
    line.reader.stop()
    assert line.send(b"1.1") == (1.0, 1)


@pytest.mark.parametrize(("pause_ms", "age_ms"), [(1, 0), (2, 3), (9, 10)])
def test_what_comes_while_nobody_looks_is_as_old_as_the_look_before(line, pause_ms, age_ms):
    line.send(b"1.0", 5)
    line.clock.sleep_until(line.clock.now_s() + 1e-3 * pause_ms)
    assert line.send(b"1.1") == (1.1, age_ms)


def test_the_first_reading_needs_another_beside_it(line):
    """A line that lost its first digits is a number; the very first one was once believed."""
    assert line.send(b"2.3") is None
    assert line.send(b"512.3") is None
    assert line.send(b"512.4") == (512.4, 0)
    assert line.reader.rejected == 1


CAPACITY_N = 100.0
# Through zero; at most 0.75 N in a reading.
FORCES_N = [40.0 + 45.0 * math.sin(k / 60.0) for k in range(200, 300)]


def lorenz_frames():
    """250 counts a newton."""
    return [
        bytes((k % 256,)) + round(250 * f).to_bytes(2, "big", signed=True) for k, f in enumerate(FORCES_N)
    ]


PROTOCOLS = {
    "%12.4f": (lambda: loadstar_stream(1.0, CAPACITY_N), [b"%12.4f\r\n" % f for f in FORCES_N]),
    "%.2f": (lambda: loadstar_stream(1.0, CAPACITY_N), [b"%.2f\r\n" % f for f in FORCES_N]),
    "%g": (lambda: loadstar_stream(1.0, CAPACITY_N), [f"{f:.3g}\r\n".encode() for f in FORCES_N]),
    "with unit": (
        lambda: pattern_stream(r"(?P<value>-?[\d.]+) (?P<unit>k?N)", "N", 1.0, 1e9),
        [b"%.5f kN\n" % (1e-3 * f) for f in FORCES_N],
    ),
    "binary": (lambda: LorenzStream(1.0 / 250.0), lorenz_frames()),
}


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("damage", ["lost", "flipped"])
def test_one_damaged_byte_never_gives_a_wrong_force(protocol, damage):
    """Each byte of the last 30 readings in turn; "0.65" without its point was once taken for 65 N."""
    make, frames = PROTOCOLS[protocol]
    before, ends = len(b"".join(frames[:-40])), np.cumsum([len(frame) for frame in frames])
    accepted = 0
    for place in range(before, ends[-10]):
        read, write = os.pipe()
        clock = SimulatedClock()
        reader = SerialReader(read, make(), clock, CAPACITY_N)
        struck = int(np.searchsorted(ends, place, side="right"))
        try:
            for k, frame in enumerate(frames):
                at = place - (ends[k] - len(frame))
                sent = frame
                if k == struck:
                    wrong = b"" if damage == "lost" else bytes((frame[at] ^ 0x10,))
                    sent = frame[:at] + wrong + frame[at + 1 :]
                os.write(write, (b"\r\n" if k == 0 and protocol != "binary" else b"") + sent)
                clock.sleep_until(clock.now_s() + 1e-3)
                seen = reader.newest
                reader.look()
                if k < struck - 5 or reader.newest in (None, seen):
                    continue
                # No more than one reading old, and no more than the accepted jump beside that.
                assert abs(reader.newest.force_n - FORCES_N[k]) < 0.01 * CAPACITY_N + 0.8, (place, k)
                accepted += k > struck
        finally:
            os.close(read)
            os.close(write)
    assert accepted > 5 * (ends[-10] - before)  # it goes on after the damage


def test_a_fast_push_is_followed(line):
    """0 to 300 N in three readings on a sensor of 1000 N: late by one reading, once."""
    line.send(b"0.0", 5)
    assert [line.send(b"%.1f" % f)[0] for f in (100.0, 200.0, 300.0, 300.1)] == [0.0, 200.0, 300.0, 300.1]


def test_a_single_peak_is_left_out_and_counted(line):
    line.send(b"1.0", 5)
    assert line.send(b"70.0") == (1.0, 1)
    assert line.send(b"1.1") == (1.1, 0)
    assert line.reader.rejected == 1
