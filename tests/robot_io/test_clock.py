"""Clocks that never go back; output of C code is captured in memory."""

import subprocess
import sys

import pytest

from palpate.robot_io.clock import Clock, MonotonicClock, SimulatedClock


class WrittenClock(Clock):
    """A real clock for tests: notes until when it was asked to wait."""

    def __init__(self):
        self.waited_until = []

    def now_s(self):
        return 100.0

    def sleep_until(self, time_s):
        self.waited_until.append(time_s)


def test_simulated_time_advances_only_while_waiting():
    clock = SimulatedClock()
    assert [clock.now_s(), clock.now_s()] == [0.0, 0.0]
    clock.sleep_until(2.5)
    assert clock.now_s() == 2.5


@pytest.mark.parametrize("past_s", [1.0, 0.5, -3.0, float("nan"), float("-inf")])
def test_simulated_time_never_goes_back(past_s):
    clock = SimulatedClock()
    clock.sleep_until(1.0)
    clock.sleep_until(past_s)
    assert clock.now_s() == 1.0


def test_listeners_get_every_advance_once_with_the_new_time():
    clock, heard = SimulatedClock(), []
    clock.subscribe(lambda time_s: heard.append((time_s, clock.now_s())))
    for time_s in (0.5, 0.5, 0.2, 0.75):
        clock.sleep_until(time_s)
    assert heard == [(0.5, 0.5), (0.75, 0.75)]


def test_paced_clock_follows_a_real_clock_from_its_start():
    pace = WrittenClock()
    clock = SimulatedClock(pace)
    clock.sleep_until(0.25)
    clock.sleep_until(0.5)
    assert pace.waited_until == [100.25, 100.5]
    pace = SimulatedClock()
    clock = SimulatedClock(pace)
    pace.sleep_until(1.0)  # a world is loaded, a session opened
    for tick in range(1, 901):
        clock.sleep_until(1e-3 * tick)
        assert pace.now_s() == pytest.approx(1.0 + clock.now_s())


def test_stall_shifts_later_ticks_and_a_late_tick_does_not():
    pace = SimulatedClock()
    clock = SimulatedClock(pace)
    clock.sleep_until(0.1)
    pace.sleep_until(0.11)  # one tick took 10 ms, which is caught up with
    clock.sleep_until(0.101)
    clock.sleep_until(0.12)
    assert pace.now_s() == pytest.approx(0.12)
    pace.sleep_until(5.12)  # the program was held up for 5 s
    for tick in range(1, 200):
        clock.sleep_until(0.12 + 1e-3 * tick)
        assert pace.now_s() == pytest.approx(5.0 + clock.now_s())


def test_monotonic_clock_waits_only_for_the_future():
    clock = MonotonicClock()
    start_s = clock.now_s()
    clock.sleep_until(start_s + 0.01)
    woken_s = clock.now_s()
    assert woken_s >= start_s + 0.01
    clock.sleep_until(start_s - 1e9)  # would take for ever if it were waited for
    assert clock.now_s() >= woken_s


# In a process of its own: an audit hook stays for good.
PROGRAM = """
import os, sys
from palpate.robot_io.capture_output import STDERR, STDOUT, capture_output

opened = []
def note(event, arguments):
    if event == "open" and isinstance(arguments[0], str | bytes) and arguments[2] & (os.O_WRONLY | os.O_RDWR):
        opened.append(arguments[0])

sys.addaudithook(note)
lines = []
with capture_output(lines, STDOUT, STDERR):
    os.write(STDOUT, b"first\\n")
    os.write(STDERR, b"second\\n")
print(lines, opened)
"""


def test_output_is_captured_in_memory():
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == "['first', 'second'] []\n"
    assert done.stderr == ""
