"""Probes a simulated object as a session would, and keeps the ticks in memory: for many short runs."""

from collections.abc import Mapping

import numpy as np

from control.loop.loop import run_loop
from control.loop.tick_record import tick_stream
from control.probing.plan import ProbingPlan
from control.probing.task import ProbingTask
from palpate.runs.robots import is_simulated
from palpate.runs.session import SIMULATED_DRIVERS
from robot_io.clock import SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.errors import InputError, PalpateError
from robot_io.guard import Guard
from robot_io.robot import build_robot
from robot_io.robot_file import RobotFile
from robot_io.session import Samples
from sim_backend.drivers import SimulatedBus
from sim_backend.scenario import Scenario


class TickRecords:
    """A log of ticks in memory; see `control.loop.tick_record.TickLog`."""

    dropped = 0
    failure = None

    def __init__(self) -> None:
        self.records: list[tuple[object, ...]] = []

    def append(self, stream_name: str, record: tuple[object, ...]) -> None:
        """Keep a tick's record."""
        self.records.append(record)

    def event(self, time_s: float, kind: str, text: str, data: Mapping[str, object] | None = None) -> None:
        """Nothing is kept of events."""

    def samples(self, joint_count: int) -> Samples:
        """All ticks, as a session would give them."""
        stream = tick_stream(joint_count)
        return Samples.from_records(stream, np.array(self.records, stream.dtype))


def probe_in_memory(robot_file: RobotFile, scenario: Scenario, plan: ProbingPlan) -> Samples:
    """Probe a simulated object as fast as the machine can; returns the stream "tick".

    Raises:
        InputError: robot file, scenario and plan do not fit each other, or the robot is not simulated.
        PalpateError: the arm was stopped, or a run gave no data.
    """
    if not is_simulated(robot_file):
        raise InputError(f"robot '{robot_file.name}' is not simulated")
    clock, log = SimulatedClock(), TickRecords()
    task = ProbingTask.from_robot_file(robot_file, plan)
    guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count)
    robot = build_robot(robot_file, DriverCatalogue(SIMULATED_DRIVERS), clock)
    for bus in robot.buses.values():
        if isinstance(bus, SimulatedBus):
            bus.use_scenario(scenario)
    with robot:
        run_loop(robot, guard, task, clock, log, rate_hz=robot_file.control_rate_hz).raise_for_trip()
    if task.failures:
        raise PalpateError(f"while probing: {task.failures[0]}")
    return log.samples(robot.joint_count)
