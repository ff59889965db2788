"""A Dynamixel bus with its drivers, in lock-step with emulated servos that turn a simulated arm."""

from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.dynamixel.bus import DynamixelBus, DynamixelEncoder, DynamixelTorque
from palpate.robot_io.robot_file import load_robot_file
from palpate.sim_backend.emulators.dynamixel import DynamixelMounting, EmulatedDynamixelLine
from palpate.sim_backend.emulators.faults import Fault
from palpate.sim_backend.emulators.hardware import HardwareEmulator, Plant
from palpate.sim_backend.scenario import load_scenario

ROBOT_FILE = Path(__file__).resolve().parents[3] / "robots" / "dynamixel_3dof.yaml"
TICK_S = 1e-3
READ_S = 0.6e-3  # as the control loop allows


class Sample(NamedTuple):
    """Newest readings of a bus."""

    sampled_at_s: float
    position_rad: np.ndarray
    velocity_rad_s: np.ndarray
    torque_nm: np.ndarray


class DynamixelSetup:
    """Attributes: clock, line (the emulated servos), plant, bus, encoder, torque (the drivers)."""

    def __init__(self, bolted=None, encoder=None, link=None, **settings):
        """`settings` change the driver's; `bolted` changes how servos really are, by id; `link` is a path at
        which the port is found, also after it is plugged in again."""
        self.robot_file = load_robot_file(ROBOT_FILE)
        section = dict(self.robot_file.buses["motors"].settings) | settings
        self.clock = SimulatedClock()
        self.plant = Plant(self.robot_file, load_scenario("default"), 0.0)
        bolted = bolted or {}
        self._really = [
            DynamixelMounting(**servo | bolted.get(servo["id"], {})) for servo in section["servos"]
        ]
        self._baud_rate, self._link = section["baud_rate"], link
        self._emulators = []
        self.plug_in()
        port = settings.get("port") or str(link or self.line.path)
        self.bus = DynamixelBus(section | {"port": port}, DriverContext(self.clock, self.robot_file))
        context = DriverContext(self.clock, self.robot_file, self.bus)
        self.encoder, self.torque = DynamixelEncoder(encoder or {}, context), DynamixelTorque({}, context)

    def plug_in(self):
        """Put a line of servos that have just got power at the end of the cable."""
        now_s = self.clock.now_s()
        self.line = EmulatedDynamixelLine(self._really, self.plant, baud_rate=self._baud_rate, start_s=now_s)
        self._emulators.append(HardwareEmulator(self.plant, [self.line], self.clock))
        if self._link:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.line.path)

    def start(self):
        self.bus.configure()
        self.bus.activate()
        self.torque.activate()

    def read(self):
        self.clock.sleep_until(self.clock.now_s() + TICK_S)
        self.bus.poll(self.clock.now_s() + READ_S)
        position, velocity, torque = self.bus.position, self.bus.velocity, self.bus.torque
        return Sample(position.sampled_at_s, position.value, velocity.value, torque.value)

    def tick(self, torque_nm=(0.5, 0.3, 0.1)):
        sample = self.read()
        self.torque.stage_torque(torque_nm)
        self.bus.flush(self.clock.now_s() + READ_S)
        return sample

    def wait(self, time_s):
        """Say nothing for so long."""
        end_s = self.clock.now_s() + time_s
        while self.clock.now_s() < end_s:
            self.clock.sleep_until(min(end_s, self.clock.now_s() + TICK_S))

    def befall(self, **fault):
        """A fault from now on."""
        self.line.faults.add(Fault(from_s=self.clock.now_s(), **fault))

    def exerted_nm(self):
        """What the servos really do (n) [N m]."""
        return self.plant.world.truth().drive_torque_nm

    def close(self):
        self.bus.close()
        for setup in self._emulators:
            setup.close()


@contextmanager
def dynamixel_setup(**changes):
    setup = DynamixelSetup(**changes)
    try:
        yield setup
    finally:
        setup.close()
