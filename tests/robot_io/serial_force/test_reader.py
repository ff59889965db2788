"""What follows a damaged line is doubted: where one digit was flipped, the next may be as well."""

import os

import pytest

from robot_io.clock import SimulatedClock
from robot_io.serial_force import SerialReader
from robot_io.serial_force.loadstar import LoadstarStream


class Line:
    """A sensor's line without a sensor; each line arrives 1 ms after the one before."""

    def __init__(self):
        self._read, self._write = os.pipe()
        self.clock = SimulatedClock()
        self.reader = SerialReader(self._read, LoadstarStream(1.0, 100.0), self.clock)
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
    made = Line()
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
    assert line.send(b"1.0", 2) is None
    assert line.send(b"1.0") == (1.0, 0)
