"""The Dynamixel drivers in real time: over a pseudo terminal, on the machine's clock, and killed."""

import multiprocessing
import os
import time

import numpy as np
import pytest

from robot_io.clock import MonotonicClock
from robot_io.driver import DriverCatalogue
from robot_io.robot import build_robot
from robot_io.robot_file import parse_robot_file
from robot_io.types import Command, Status
from sim_backend.emulators.dynamixel import control_table as table
from sim_backend.emulators.wiring import wire_up
from sim_backend.scenario import load_scenario
from tests.wire.test_dynamixel import ROBOT

PATIENCE_S = 30.0  # on a busy machine

# A servo that is emulated by a thread answers late on a busy machine, and the driver rightly calls it silent.
pytestmark = pytest.mark.skipif(
    "PALPATE_REAL_TIME" not in os.environ, reason="wants a quiet machine: set PALPATE_REAL_TIME=1 to run it"
)


@pytest.fixture
def arm():
    """Emulated devices that run in a thread; their watchdogs are patient, as the machine may be busy."""
    text = ROBOT.read_text(encoding="utf-8").replace("watchdog_s: 0.06", "watchdog_s: 0.5")
    arm = wire_up(parse_robot_file(text, ROBOT), load_scenario("default"), MonotonicClock())
    arm.bench.start()
    yield arm
    arm.bench.close()


def command(robot, ticks):
    """Some torque for so many good ticks, at whatever rate the machine manages."""
    clock = robot.clock
    good, give_up_s = 0, clock.now_s() + PATIENCE_S
    while good < ticks and clock.now_s() < give_up_s:
        measurement = robot.read(clock.now_s() + 0.05)
        robot.write(Command(np.array([0.8, 0.4, 0.1])), clock.now_s() + 0.05)
        good += measurement.encoder_status is Status.OK


def drive_until_killed(text, running):
    """A control program that never comes to its end."""
    robot = build_robot(parse_robot_file(text, ROBOT), DriverCatalogue(), MonotonicClock())
    robot.configure()
    robot.activate()
    command(robot, 20)
    running.set()
    command(robot, 10**9)


def wait_for(condition):
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "it never came to that"
        time.sleep(0.01)


def goals(arm):
    return [servo.memory.get(table.GOAL_CURRENT) for servo in arm.wires["motors"].servos.values()]


def test_reading_and_commanding_in_real_time(arm):
    with build_robot(arm.robot_file, DriverCatalogue(), MonotonicClock()) as robot:
        robot.activate()
        command(robot, 30)
        assert all(goals(arm))
        robot.deactivate()
    assert not any(servo.memory.get(table.TORQUE_ENABLE) for servo in arm.wires["motors"].servos.values())


def test_the_watchdogs_catch_a_killed_process(arm):
    context = multiprocessing.get_context("spawn")
    running = context.Event()
    process = context.Process(target=drive_until_killed, args=(arm.robot_file.text, running))
    process.start()
    try:
        assert running.wait(PATIENCE_S)
        assert all(goals(arm))
    finally:
        process.kill()
        process.join()
    servos = arm.wires["motors"].servos.values()
    wait_for(lambda: all(servo.memory.get(table.BUS_WATCHDOG) == -1 for servo in servos))
    assert goals(arm) == [0, 0, 0]
