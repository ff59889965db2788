"""Robots on emulated wires in lock-step, with fault injection."""

from collections.abc import Sequence
from copy import copy
from pathlib import Path

import can
import numpy as np
import yaml

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.robot import Robot, build_robot
from palpate.robot_io.robot_file import parse_robot_file
from palpate.robot_io.types import Command, Measurement
from palpate.sim_backend.emulators import Fault, FaultKind, Faults
from palpate.sim_backend.emulators.wiring import WiredArm, wire_up
from palpate.sim_backend.imperfection import Imperfection
from palpate.sim_backend.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[2]
ODRIVE = ROOT / "robots" / "odrive_3dof.yaml"
V0_5 = (  # changes of that file for the older firmware
    ('firmware: "0.6"', 'firmware: "0.5"'),
    ("max_torque_nm:", "torque_constant_nm_a: 0.05, max_torque_nm:"),
)
DYNAMIXEL = ROOT / "robots" / "dynamixel_3dof.yaml"
CUBEMARS = ROOT / "robots" / "cubemars_3dof.yaml"
READ_SHARE = 0.6  # of a tick, as the control loop allows
DAMIAO = ROOT / "robots" / "damiao_3dof.yaml"
ROBSTRIDE = ROOT / "robots" / "robstride_3dof.yaml"
MOTEUS = ROOT / "robots" / "moteus_3dof.yaml"
SO101 = ROOT / "robots" / "so101.yaml"
LINES = (  # a load cell that is read by a pattern, in place of the ODrive arm's
    "{driver: loadstar, bus: load_cell, capacity_n: 100.0}",
    "{driver: force_lines, bus: load_cell, capacity_n: 100.0, "
    r"pattern: '\s*(?P<value>[-+]?[\d.]+) (?P<unit>\w+)'}",
)

CELL = (  # one on a microcontroller, in its place
    LINES[0],
    "{driver: microcontroller_cell, bus: load_cell, capacity_n: 100.0, newtons_per_count: 2.0e-5, "
    "zero_counts: -30000, rate_hz: 320}",
)
DYNAMIXEL_PAIR = (  # a second servo on the shoulder, mirrored
    "{id: 1, model: XM540-W270, zero_rad: 3.14159265}",
    "{id: 1, model: XM540-W270, zero_rad: 3.14159265, second: {id: 4, reversed: true, zero_rad: 3.1}}",
)
FEETECH_PAIR = (
    "{id: 2, model: STS3215-12V, zero_rad: 3.14159265}",
    "{id: 2, model: STS3215-12V, zero_rad: 3.14159265, homing_offset: -31, "
    "second: {id: 7, reversed: true, zero_rad: 3.2, homing_offset: 85}}",
)
MARK10 = (LINES[0], "{driver: mark10, bus: load_cell, capacity_n: 100.0}")  # a gauge, in its place
BOTA = (  # one axis of a Bota sensor, in its place, on a line that is fast enough
    (LINES[0], "{driver: bota, bus: load_cell, axis: y, capacity_n: 100.0}"),
    ("baud_rate: 230400", "baud_rate: 460800"),
)
NET_FT = (  # one axis of a Net F/T, and the network that it is on, in their places
    (LINES[0], "{driver: net_ft, bus: load_cell, axis: z, capacity_n: 100.0, counts_per_force: 1000000}"),
    (
        "driver: serial_line\n    port: /dev/serial/by-id/usb-Loadstar_DI-1000\n    baud_rate: 230400",
        "driver: net_ft_line\n    host: 192.168.1.1",
    ),
)


class EmulatedRobot:
    """A robot of real drivers and the emulated devices behind it.

    Args:
        path: robot file.
        changes: pairs of what is replaced in its text by what.
        hidden: what is wrong with the arm.
    """

    def __init__(
        self,
        path: Path = ODRIVE,
        changes: Sequence[tuple[str, str]] = (),
        hidden: Sequence[Imperfection] = (),
    ) -> None:
        text = path.read_text(encoding="utf-8")
        for old, new in changes:
            if old not in text:
                raise ValueError(f"'{old}' is not in {path}")
            text = text.replace(old, new)
        self.clock = SimulatedClock()
        self.faults = {"motors": Faults(), "load_cell": Faults()}
        robot_file = parse_robot_file(text, path)
        scenario = load_scenario("default", ROOT).with_hidden(hidden)
        self.arm: WiredArm = wire_up(robot_file, scenario, self.clock, self.faults)
        self.robot: Robot = build_robot(self.arm.robot_file, DriverCatalog(), self.clock)
        self.period_s = 1.0 / robot_file.control_rate_hz

    @property
    def text(self) -> str:
        """The robot file of the emulated devices."""
        return yaml.safe_dump(self.arm.robot_file.document.data, sort_keys=False)

    def start(self) -> "EmulatedRobot":
        self.robot.configure()
        self.robot.activate()
        self.ticks(5)
        return self

    def inject_fault(self, bus: str, kind: FaultKind, **details) -> None:
        """From now on, unless `details` say otherwise."""
        self.faults[bus].add(Fault(kind=kind, from_s=self.clock.now_s(), **details))

    def tick(self, torque_nm: Sequence[float] | None = (0.0, 0.0, 0.0)) -> Measurement:
        """Read, and command unless `torque_nm` is None."""
        self.clock.sleep_until(self.clock.now_s() + self.period_s)
        measurement = self.robot.read(self.clock.now_s() + READ_SHARE * self.period_s)
        if torque_nm is not None:
            self.robot.write(Command(np.array(torque_nm, float)), self.clock.now_s())
        return measurement

    def ticks(self, count: int, torque_nm: Sequence[float] | None = (0.0, 0.0, 0.0)) -> Measurement:
        for _ in range(count):
            measurement = self.tick(torque_nm)
        return measurement

    def ticks_until(self, done, most: int = 500, torque_nm=(0.0, 0.0, 0.0)) -> int:
        """How many ticks it took until `done(measurement)`."""
        for count in range(1, most + 1):
            if done(self.tick(torque_nm)):
                return count
        raise AssertionError(f"not within {most} ticks")

    def intrude(self, *frames: tuple[int, bytes]) -> None:
        """Frames (id, data) of a stranger on the motors' CAN bus."""
        channel = self.arm.robot_file.buses["motors"].settings["channel"]
        with can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) as stranger:
            for number, data in frames:
                stranger.send(can.Message(arbitration_id=number, data=data, is_extended_id=False))

    @property
    def motors(self) -> list:
        """The emulated motors on a CAN bus, by joint."""
        return self.arm.wires["motors"]._nodes

    @property
    def servos(self) -> dict:
        """The emulated servos on a serial line, by id."""
        return self.arm.wires["motors"].servos

    @property
    def sensor(self):
        """The emulated force sensor."""
        return self.arm.wires["load_cell"]._sensor

    def hold(self):
        """Let the arm stand, whatever drives it, until the function that this returns is called."""
        engine = self.arm.plant.world._engine
        engine.step = lambda: None
        return lambda: engine.__dict__.pop("step")

    @property
    def drive_torque_nm(self) -> np.ndarray:
        """True torques of the drives, shape (n,) [N m]."""
        return np.array(self.arm.plant.world._torque_nm)

    @property
    def problem(self) -> str:
        """What the user reads, once samples are too old."""
        return "; ".join((*self.robot.bus_errors.values(), *self.robot.bus_delays.values()))

    def close(self) -> None:
        self.robot.close()
        self.arm.emulator.close()


def add_twin(arm: EmulatedRobot, joint: int = 2) -> None:
    """A second motor with the id of the first, on another joint."""
    wire = arm.arm.wires["motors"]
    twin = copy(wire._nodes[0])
    twin._joint = joint
    wire._nodes += (twin,)
