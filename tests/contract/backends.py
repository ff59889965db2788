"""The backends that keep the contract. A new one adds itself to `BACKENDS`; every test here runs on it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robot_io.clock import Clock, SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.robot import Robot, build_robot
from robot_io.robot_file import RobotFile, load_robot_file
from robot_io.types import Command, Measurement
from tests.mock_robot import WATCHDOG_S, mock_bus, mock_robot_file

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Bench:
    """One robot on the bench, in state NEW.

    press: makes the force sensor feel about this force [N] at the next ticks, or None where nobody can.
    watchdog_s: after how long without commands the drives let go [s], or None where they have no watchdog.
    """

    robot: Robot
    robot_file: RobotFile
    clock: Clock
    press: Callable[[float], None] | None = None
    watchdog_s: float | None = None

    @property
    def period_s(self) -> float:
        return 1.0 / self.robot_file.control_rate_hz

    def read(self) -> Measurement:
        """Wait for the next tick and read."""
        self.clock.sleep_until(self.clock.now_s() + self.period_s)
        return self.robot.read(self.clock.now_s() + self.period_s)

    def tick(self, torque_nm=None) -> Measurement:
        """Wait for the next tick, read and command."""
        measurement = self.read()
        torque_nm = np.zeros(self.robot.joint_count) if torque_nm is None else np.asarray(torque_nm, float)
        self.robot.write(Command(torque_nm), self.clock.now_s() + self.period_s)
        return measurement

    def settle(self) -> Measurement:
        """Read until every device has sampled."""
        for _ in range(1000):
            measurement = self.read()
            if np.isfinite([measurement.encoder_at_s, measurement.torque_at_s, measurement.force_at_s]).all():
                return measurement
        raise TimeoutError("a device never sampled")


@dataclass(frozen=True)
class Backend:
    """A kind of robot: its name, how to make a fresh one, and why it is not here (None: it is)."""

    name: str
    open: Callable[[], Bench]
    missing: Callable[[], str | None] = lambda: None


def open_mock() -> Bench:
    robot_file, clock = mock_robot_file(), SimulatedClock()
    robot = build_robot(robot_file, DriverCatalogue("tests.mock_robot"), clock)

    def press(force_n: float) -> None:
        mock_bus(robot).plant.hand_force_n = force_n

    return Bench(robot, robot_file, clock, press, WATCHDOG_S)


SIM_ROBOT_FILE = ROOT / "sim_backend" / "arms" / "follower" / "follower.yaml"


def open_simulation() -> Bench:
    robot_file, clock = load_robot_file(SIM_ROBOT_FILE), SimulatedClock()
    robot = build_robot(robot_file, DriverCatalogue("sim_backend.drivers"), clock)

    def press(force_n: float) -> None:
        """Hold the arm where it is, tool down, and bring the surface up to it."""
        world = robot.buses["world"].world
        world.held = True
        depth_m = force_n / world.object.law.stiffness_n_m if force_n else -0.05
        world.object.move_surface(world.truth().tip_position_world_m[2] + depth_m)

    return Bench(robot, robot_file, clock, press)


BACKENDS = [
    Backend("mock", open_mock),
    Backend(
        "simulation",
        open_simulation,
        lambda: None if SIM_ROBOT_FILE.exists() else f"{SIM_ROBOT_FILE.name} is not there",
    ),
]
