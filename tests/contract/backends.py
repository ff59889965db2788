"""Backends that the contract tests run on; a new one is added to `BACKENDS`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.robot_io.clock import Clock, SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.robot import Robot, build_robot
from palpate.robot_io.robot_file import RobotFile, load_robot_file, parse_robot_file
from palpate.robot_io.types import Command, Measurement
from palpate.runs.robots import emulate
from palpate.sim_backend.imperfection import Imperfection
from palpate.sim_backend.imperfections.joint import HiddenArmature
from palpate.sim_backend.scenario import load_scenario
from palpate.sim_backend.world import World
from tests.contract.documented import documented_driver
from tests.mock_robot import WATCHDOG_S, mock_bus, mock_robot_file
from tests.wire.parts import (
    BOTA,
    CUBEMARS,
    DAMIAO,
    DYNAMIXEL,
    DYNAMIXEL_PAIR,
    FEETECH_PAIR,
    MOTEUS,
    NET_FT,
    ODRIVE,
    ROBSTRIDE,
    SO101,
    V0_5,
    EmulatedRobot,
)

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class RobotSetup:
    """One robot in state NEW.

    press: makes the force sensor feel about this force [N] at the next ticks, or None where nobody can.
    watchdog_s: after how long without commands the drives let go [s], or None where they have no watchdog.
    clear_away: ends what stands behind the robot.
    holds: activated drives hold the joints where they stand until the first command.
    """

    robot: Robot
    robot_file: RobotFile
    clock: Clock
    press: Callable[[float], None] | None = None
    watchdog_s: float | None = None
    clear_away: Callable[[], None] = lambda: None
    holds: bool = False

    def close(self) -> None:
        self.robot.close()
        self.clear_away()

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
    """A kind of robot: its name, and how to make a fresh one.

    known: what another backend has too ("drives", "force"): its own contract need not be shown twice.
    """

    name: str
    open: Callable[[], RobotSetup]
    known: str = ""


def open_mock() -> RobotSetup:
    robot_file, clock = mock_robot_file(), SimulatedClock()
    robot = build_robot(robot_file, DriverCatalog("tests.mock_robot"), clock)

    plant = mock_bus(robot).plant
    return RobotSetup(
        robot, robot_file, clock, lambda force_n: setattr(plant, "hand_force_n", force_n), WATCHDOG_S
    )


def press(world: World, force_n: float) -> None:
    """Hold the arm where it is, tool down, and bring the surface up to it."""
    world.held = True
    world.place(world.truth().joint_position_rad)
    depth_m = force_n / world.object.law.stiffness_n_m if force_n else -0.05
    world.object.move_surface(world.truth().tip_position_world_m[2] + depth_m)


def open_simulation() -> RobotSetup:
    robot_file = load_robot_file(ROOT / "sim_backend" / "arms" / "follower" / "follower.yaml")
    clock = SimulatedClock()
    robot = build_robot(robot_file, DriverCatalog("palpate.sim_backend.drivers"), clock)

    return RobotSetup(robot, robot_file, clock, lambda force_n: press(robot.buses["world"].world, force_n))


def wired(
    path: Path,
    changes: Sequence[tuple[str, str]] = (),
    watchdog_s: float | None = None,
    hidden: Sequence[Imperfection] = (),
) -> RobotSetup:
    """Real drivers of a robot file that is shipped, changed, in lock-step with emulated devices."""
    made = EmulatedRobot(path, changes, hidden)
    return RobotSetup(
        *(made.robot, made.arm.robot_file, made.clock),
        lambda force_n: press(made.arm.plant.world, force_n),
        watchdog_s,
        made.arm.emulator.close,
    )


def odrive(*changes: tuple[str, str]) -> RobotSetup:
    return wired(ODRIVE, changes, 0.05)


LOADSTAR = "driver: loadstar"
GAUGE = (  # a force gauge that writes lines and counts tension as positive
    LOADSTAR,
    r"driver: force_lines, reversed: true, pattern: '\s*(?P<value>[-+]?[\d.]+) (?P<unit>\w+)'",
)
CELL = (  # the load cell on a microcontroller; tension is positive for it
    LOADSTAR,
    "driver: microcontroller_cell, newtons_per_count: 2.0e-5, zero_counts: 500, rate_hz: 320, reversed: true",
)
MARK10 = (LOADSTAR, "driver: mark10, reversed: true")  # one that is asked for each reading
TURNED = ("axis: y", "axis: y, reversed: true, rate_hz: 400")
POUNDS = ("counts_per_force: 1000000", "counts_per_force: 4500000, unit: lbf, reversed: true")
PLAIN = (  # other servos, with the plain sync read, and the velocity by differentiation
    ("XM540-W270", "XH540-W270"),
    ("fast_sync_read: true", "fast_sync_read: false"),
    ("velocity: servo", "velocity: difference"),
)


def open_documented() -> RobotSetup:
    """The driver of docs/how-to/driver.md, on the gauge that it is written for."""
    text, pattern = ODRIVE.read_text(encoding="utf-8"), "(?P<value>[-+]?[0-9.]+) (?P<unit>[a-z]+)"
    built = text.replace(LOADSTAR, f"driver: force_lines, pattern: '{pattern}'")
    named = text.replace(LOADSTAR, "driver: line_gauge")
    clock = SimulatedClock()
    arm = emulate(
        parse_robot_file(named, ODRIVE),
        load_scenario("default", ROOT),
        clock,
        as_built=parse_robot_file(built, ODRIVE),
    )
    robot = build_robot(arm.robot_file, DriverCatalog(documented_driver()), clock)
    return RobotSetup(robot, arm.robot_file, clock, None, 0.05, arm.emulator.close)


ROTORS = [HiddenArmature(joint=1, inertia_kg_m2=0.056)]  # of two servos, which drive little else


BACKENDS = [
    Backend("mock", open_mock),
    Backend("odrive_0.6_loadstar", odrive),
    Backend("odrive_0.5_force_lines", lambda: odrive(*V0_5, GAUGE)),
    Backend("odrive_0.6_cell", lambda: odrive(CELL), known="drives"),
    Backend("odrive_0.6_mark10", lambda: odrive(MARK10), known="drives"),
    Backend("odrive_0.6_net_ft", lambda: odrive(*NET_FT, POUNDS), known="drives"),
    Backend("odrive_0.6_bota", lambda: odrive(*BOTA, TURNED), known="drives"),
    Backend("documented_driver", open_documented, known="drives"),
    Backend("cubemars_lorenz", lambda: wired(CUBEMARS, watchdog_s=0.1)),
    Backend("damiao_cell", lambda: wired(DAMIAO, watchdog_s=0.1), known="force"),
    Backend("robstride_cell", lambda: wired(ROBSTRIDE, watchdog_s=0.1), known="force"),
    Backend("moteus_cell", lambda: wired(MOTEUS, watchdog_s=0.1), known="force"),
    # servos that know the fast sync read; their watchdog counts reading as a sign of life too
    Backend("dynamixel_fast", lambda: wired(DYNAMIXEL)),
    Backend("dynamixel_plain", lambda: wired(DYNAMIXEL, PLAIN), known="force"),
    # servos without torque mode and watchdog, and a load cell for 20 dollars
    Backend("feetech_so101", lambda: replace(wired(SO101), holds=True)),
    Backend("dynamixel_pair", lambda: wired(DYNAMIXEL, [DYNAMIXEL_PAIR]), known="force"),
    # two servos on the first joint, one of them mirrored
    Backend(
        "feetech_pair",
        lambda: replace(wired(SO101, [FEETECH_PAIR], hidden=ROTORS), holds=True),
        known="force",
    ),
    Backend("simulation", open_simulation),
]
