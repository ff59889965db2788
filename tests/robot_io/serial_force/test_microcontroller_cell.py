"""A load cell on a microcontroller: lines against its firmware, and damage."""

import shutil
import subprocess

import pytest

from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.drivers.serial_force.microcontroller_cell import CellStream, parse_sample, verified_text
from palpate.robot_io.errors import DeviceError, ProtocolError
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import parse_robot_file
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators.serial_sensors import cell_line
from tests.wire.parts import CELL, ODRIVE, ROOT

FIRMWARE = ROOT / "docs" / "firmware" / "load_cell" / "load_cell.ino"
COUNTS = (0, -1, 123456, -123456, 8388607, -8388608)
ARDUINO = """#pragma once
#include <cstdint>
#include <cstdio>
#include <cstring>
struct Stream {
  const char* heard = "??";
  void begin(long) {}
  int available() { return *heard; }
  int read() { return *heard++; }
  void print(const char* text) { fputs(text, stdout); }
};
extern Stream Serial;
struct Bus {  // a converter whose samples come from the command line
  uint8_t place = 0; long counts = 0; int at = 0; bool fresh = true;
  void begin() {} void setClock(long) {} void beginTransmission(int) { at = 0; }
  void write(int value) { if (at++ == 0) place = value; }
  int endTransmission(bool = true) { return 0; }
  int requestFrom(int, int count) { at = 0; return count; }
  int read() { return place == 0 ? (fresh ? 0x20 : 0) : counts >> (16 - 8 * at++) & 0xFF; }
};
extern Bus Wire;
inline void delay(int) {}
inline unsigned long millis() { return 0; }
"""
MAIN = """#include <cstdlib>
#include "Arduino.h"
Stream Serial; Bus Wire;
#include "load_cell.ino"
int main(int n, char** values) {
  setup();
  for (int i = 1; i < n; ++i) { Wire.counts = atol(values[i]); loop(); }
}
"""


def test_firmware_and_driver_understand_each_other(tmp_path):
    if shutil.which("g++") is None:
        pytest.skip("no g++ to compile the firmware")
    (tmp_path / "Arduino.h").write_text(ARDUINO, encoding="utf-8")
    (tmp_path / "Wire.h").write_text("", encoding="utf-8")
    (tmp_path / "main.cpp").write_text(MAIN, encoding="utf-8")
    include = ("-I", tmp_path, "-I", FIRMWARE.parent)
    program = tmp_path / "cell"
    subprocess.run(["g++", "-Wall", "-Werror", *include, "-o", program, tmp_path / "main.cpp"], check=True)
    said = subprocess.run([program, *map(str, COUNTS)], check=True, capture_output=True).stdout
    who, again, *samples = said.splitlines()
    assert verified_text(who) == verified_text(again) == "cell 1 nau7802 320"
    assert [parse_sample(one) for one in samples] == list(enumerate(COUNTS, 1))


@pytest.mark.parametrize(
    "text", ["1 2 3", "1", "256 1", "-1 1", "1 8388608", "1 -8388609", "1 1.0", "fault converter", ""]
)
def test_invalid_sample_is_refused(text):
    with pytest.raises(ProtocolError):
        parse_sample(cell_line(text)[:-1])


def stream(*texts):
    made = CellStream(0.5, 10.0, 100.0, 320.0)
    return made, made.feed(b"\n" + b"".join(map(cell_line, texts)))


def test_force_is_counts_above_zero():
    assert stream("7 30", "8 -10")[1] == [10.0, -10.0]


@pytest.mark.parametrize(
    ("counters", "accepted", "rejected"),
    [
        *((old, 1, 1) for old in ((7, 7), (7, 6), (7, 7 - 127), (255, 255))),
        *((lost, 2, 0) for lost in ((7, 9), (255, 0), (250, 20))),  # some between them
        ((200, *range(90, 98)), 5, 4),  # the cell was restarted
    ],
)
def test_only_samples_with_a_later_counter_are_accepted(counters, accepted, rejected):
    made, samples = stream(*(f"{counter % 256} 30" for counter in counters))
    assert (len(samples), made.rejected) == (accepted, rejected)


def test_converter_at_its_end_is_saturated():
    assert stream("1 8388607", "2 -8388608", "3 8388606")[1][:2] == [4194298.5, -4194309.0]
    made = CellStream(1e-6, 0.0, 100.0, 320.0)
    assert made.feed(b"\n" + cell_line("1 8388607") + cell_line("2 -8388608")) == [100.0, -100.0]


@pytest.fixture
def arm(make_robot):
    return make_robot(ODRIVE, (CELL,))


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("rate_hz: 320", "rate_hz: 80", "delivers 320 samples/s, but the robot file states 80"),
        ("", b"cell 1 x 320*0000\n", "no cell answers"),
        ("", cell_line("cell 2 x 320"), "uses protocol version 2, but this driver supports version 1"),
        ("", cell_line("cell 1 x fast"), "states a rate of 'fast' samples per second, which is not"),
    ],
)
def test_another_cell_than_stated_is_refused(arm, old, new, problem):
    if not old:
        arm.sensor.receive = lambda data, now_s: new
    text = arm.text
    stated = parse_robot_file(text.replace(old, new) if old else text, ODRIVE)
    with pytest.raises(DeviceError, match=problem):
        build_robot(stated, DriverCatalog(), arm.clock).configure()


@pytest.mark.parametrize("word", ["converter", "silent"])
def test_firmware_fault_is_reported_until_the_next_sample(arm, word):
    arm.robot.configure()
    arm.ticks(20, None)
    sensor = arm.sensor
    sensor.reading = lambda force_n: cell_line(f"fault {word}")
    assert arm.ticks(5, None).force_status is Status.FAULT
    assert f"the cell says 'fault {word}'" in arm.problem
    del sensor.reading
    assert arm.ticks(5, None).force_status is not Status.FAULT
    assert not arm.problem


def test_damaged_line_costs_itself_alone(arm):
    """Where lines have checksums the next one is believed at once, however far it is from the last."""
    arm.robot.configure()
    arm.ticks(20, None)
    sensor = arm.sensor
    reading = sensor.reading
    sensor.reading = lambda force_n: b"#" + reading(50.0)
    arm.ticks(4, None)
    sensor.reading = lambda force_n: reading(50.0)
    assert arm.ticks(5, None).force_n == pytest.approx(50.0, abs=0.01)
    sensor.reading = lambda force_n: reading(float("inf"))
    assert arm.ticks(5, None).force_status is Status.SATURATED


@pytest.mark.parametrize("end_n", [1e6, -1e6], ids=["push", "pull"])
def test_either_end_of_the_range_is_saturated(arm, end_n):
    arm.robot.configure()
    sensor = arm.sensor
    reading = sensor.reading
    sensor.reading = lambda force_n: reading(end_n)
    measurement = arm.ticks(20, None)
    assert measurement.force_status is Status.SATURATED
    assert measurement.force_n * end_n > 0.0
