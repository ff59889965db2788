"""Serial reader: readings after damage are discarded, and a lost byte gives no wrong force."""

import math
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.drivers.serial_force.gauges import loadstar_stream, pattern_stream
from palpate.robot_io.drivers.serial_force.line import SerialReader
from palpate.robot_io.drivers.serial_force.lorenz import LorenzStream
from palpate.robot_io.drivers.serial_force.stream import SensorClock
from palpate.sim_backend.emulators import FaultKind
from tests.wire.parts import BOTA, CELL, CUBEMARS, NET_FT, ODRIVE


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
            self.reader.read_port()
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


def test_two_readings_after_a_damaged_line_are_discarded(line):
    assert line.send(b"1.0", 5) == (1.0, 0)
    assert line.send(b"1.\xb0") == (1.0, 1)
    assert line.send(b"9.0") == (1.0, 2)
    assert line.send(b"9.0") == (1.0, 3)
    assert line.send(b"2.0") == (2.0, 0)


def test_repeated_slips_increase_the_number_of_suspect_samples(line):
    line.send(b"1.0", 5)
    line.send(b"?")
    line.send(b"?")
    assert line.send(b"2.0", 8) == (1.0, 10)
    assert line.send(b"3.0") == (3.0, 0)


@pytest.mark.parametrize(("good", "believed"), [(100, (3.0, 0)), (99, (2.0, 104))])
def test_damage_is_forgotten_after_a_hundred_good_readings(line, good, believed):
    line.send(b"1.0", 5)
    for _ in range(4):
        line.send(b"?")
        line.send(b"2.0", good)
    line.send(b"?")
    assert line.send(b"3.0", 3) == believed


def test_permanently_damaged_line_counts_as_silent(line):
    """One in three looks like a reading, and is none."""
    line.send(b"1.0", 5)
    for k in range(300):
        assert line.send(b"7.0" if k % 3 == 2 else b"4\x00", 1) == (1.0, k + 1)
    assert line.send(b"1.5", 1000) == (1.5, 0)


def test_readings_next_to_a_damaged_line_are_discarded(line):
    line.send(b"1.0", 5)
    assert line.send(b"9.0\r\n?\r\n9.0\r\n9.0") == (1.0, 1)


def test_device_greeting_is_not_counted_as_damage(line):
    for _ in range(8):
        assert line.send(b"load cell amplifier, version 2") is None
    assert line.send(b"1.0", 3) is None  # two are discarded, one waits for the next
    assert line.send(b"1.0") == (1.0, 0)


def test_stopped_reader_does_not_poll(line):
    """Its port may be somebody else's by now."""
    line.send(b"1.0", 5)
    line.reader.stop()
    assert line.send(b"1.1") == (1.0, 1)


@pytest.mark.parametrize(("pause_ms", "age_ms"), [(1, 0), (2, 3), (9, 10)])
def test_samples_read_late_are_dated_by_the_previous_poll(line, pause_ms, age_ms):
    line.send(b"1.0", 5)
    line.clock.sleep_until(line.clock.now_s() + 1e-3 * pause_ms)
    assert line.send(b"1.1") == (1.1, age_ms)


def test_first_reading_needs_another_beside_it(line):
    """A line that lost its first digits is a number; the very first one was once believed."""
    assert line.send(b"2.3") is None
    assert line.send(b"512.3") is None
    assert line.send(b"512.4") == (512.4, 0)
    assert line.reader.rejected == 1


CAPACITY_N = 100.0
# Through zero; at most 0.75 N in a reading.
FORCES_N = [40.0 + 45.0 * math.sin(k / 60.0) for k in range(240, 300)]


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
        lambda: pattern_stream(r"(?P<value>-?[\d.]+) (?P<unit>k?N)", "N", 1.0),
        [b"%.5f kN\n" % (1e-3 * f) for f in FORCES_N],
    ),
    "binary": (lambda: LorenzStream(1.0 / 250.0), lorenz_frames()),
}


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("damage", ["lost", "flipped"])
def test_damaged_byte_never_gives_a_wrong_force(protocol, damage):
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
                reader.read_port()
                if k < struck - 5 or reader.newest in (None, seen):
                    continue
                # No more than one reading old, and no more than the accepted jump beside that.
                assert abs(reader.newest.force_n - FORCES_N[k]) < 0.01 * CAPACITY_N + 0.8, (place, k)
                accepted += k > struck
        finally:
            os.close(read)
            os.close(write)
    assert accepted > 5 * (ends[-10] - before)  # it goes on after the damage


def test_fast_push_is_followed(line):
    """0 to 300 N in three readings on a sensor of 1000 N: late by one reading, once."""
    line.send(b"0.0", 5)
    assert [line.send(b"%.1f" % f)[0] for f in (100.0, 200.0, 300.0, 300.1)] == [0.0, 200.0, 300.0, 300.1]


def test_single_peak_is_left_out_and_counted(line):
    line.send(b"1.0", 5)
    assert line.send(b"70.0") == (1.0, 1)
    assert line.send(b"1.1") == (1.1, 0)
    assert line.reader.rejected == 1


PERIOD_S, ALWAYS_S = 1e-3, 0.7e-3


def dated(late_s, clock=1.0, prompt=None, rate_error=0.0):
    """How much older than it arrived each reading is held to be; they are sampled at a steady rate [s]."""
    sensor_clock, ages_s = SensorClock(rate_error), []
    for k, late in enumerate(late_s):
        sensor_clock.advance(clock * PERIOD_S)
        arrived_s = 1000.0 + k * PERIOD_S + ALWAYS_S + late
        is_prompt = prompt is None or prompt[k]
        ages_s.append(arrived_s - sensor_clock.sampled_at_s(arrived_s, prompt=is_prompt))
    return ages_s


@given(st.lists(st.floats(0, 0.05), min_size=1, max_size=50))
def test_late_samples_are_dated_after_a_punctual_one(late_s):
    for age_s, late in zip(dated([0.0, *late_s]), [0.0, *late_s], strict=True):
        assert age_s == pytest.approx(late, abs=1e-3 * PERIOD_S * (len(late_s) + 1) + 1e-9)


@pytest.mark.parametrize("clock", [0.9991, 1.0, 1.0009])
def test_slightly_wrong_clock_makes_nothing_late(clock):
    assert max(dated([0.0] * 20_000, clock)) < 2e-6


@pytest.mark.parametrize("clock", [0.91, 0.95, 0.998, 1.0015, 1.05, 1.09])
def test_wrong_rate_is_followed_and_later_delays_are_detected(clock):
    late_s = [0.0] * 4_000 + [0.012] * 2_000
    ages_s = dated([late + 1e-4 * (k % 7) for k, late in enumerate(late_s)], clock, rate_error=0.1)
    assert max(ages_s[3_000:4_000]) < 1e-3
    assert min(ages_s[4_000:]) > 0.009  # 0.15 % of 2 s may be the clocks


def test_silence_and_late_polling_do_not_delay_later_samples():
    sensor_clock = SensorClock(longest_gap_s=0.8)
    sensor_clock.advance(PERIOD_S)
    sensor_clock.sampled_at_s(1.0, prompt=True)
    for arrived_s in (3.0, 3.0 + PERIOD_S):
        sensor_clock.advance(PERIOD_S)
        assert sensor_clock.sampled_at_s(arrived_s, prompt=True) == pytest.approx(arrived_s, abs=1e-5)
    # Its bytes are taken to be as old as the look before: that is no short way from the sensor.
    late_s = [0.0] * 5 + [-0.02] + [0.0] * 5
    assert max(dated(late_s, prompt=[late == 0.0 for late in late_s])) < 1e-4


@pytest.mark.parametrize(
    ("path", "changes"),
    [(ODRIVE, NET_FT), (ODRIVE, BOTA), (ODRIVE, (CELL,)), (CUBEMARS, ())],
    ids=["net_ft", "bota", "cell", "lorenz"],
)
@pytest.mark.parametrize("late_s", [0.001, 0.008, 0.012])
def test_late_stream_is_not_served_as_fresh(make_robot, path, changes, late_s):
    arm = make_robot(path, changes)
    arm.robot.configure()

    def ages_s(ticks):
        ages = [-arm.tick(None).force_at_s + arm.clock.now_s() for _ in range(ticks)]
        return ages[20:]

    period_s = 1 / 320 if CELL in changes else 1e-3
    waiting_s = period_s if path == CUBEMARS else 0.0  # for the next counter
    assert max(ages_s(100)) < period_s + waiting_s + 0.5e-3
    arm.inject_fault("load_cell", FaultKind.DELAY, delay_s=late_s)
    assert min(ages_s(400)) > late_s - 0.5e-3
    assert ("the last one came " in arm.problem) == (late_s > 0.005)  # more than half of any age limit
