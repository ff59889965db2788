"""A Dynamixel bus with its drivers, in lock-step with emulated servos that turn a simulated arm."""

from contextlib import contextmanager
from pathlib import Path

from robot_io.clock import SimulatedClock
from robot_io.driver import DriverContext
from robot_io.drivers.dynamixel_bus import DynamixelBus
from robot_io.drivers.dynamixel_encoder import DynamixelEncoder
from robot_io.drivers.dynamixel_torque import DynamixelTorque
from robot_io.robot_file import load_robot_file
from sim_backend.emulators.bench import Bench
from sim_backend.emulators.dynamixel import DynamixelLine, Mounting
from sim_backend.emulators.faults import Fault
from sim_backend.emulators.plant import Plant
from sim_backend.scenario import load_scenario

ROBOT_FILE = Path(__file__).resolve().parents[3] / "robots" / "dynamixel_3dof.yaml"
TICK_S = 1e-3
READ_S = 0.6e-3  # as the control loop allows


class DynamixelBench:
    """Attributes: clock, line (the emulated servos), plant, bus, encoder, torque (the drivers)."""

    def __init__(self, bolted=None, encoder=None, **settings):
        """`settings` change the driver's; `bolted` changes how servos really are, by id."""
        self.robot_file = load_robot_file(ROBOT_FILE)
        section = dict(self.robot_file.buses["motors"].settings) | settings
        self.clock = SimulatedClock()
        self.plant = Plant(self.robot_file, load_scenario("default"), 0.0)
        really = [Mounting(**servo | (bolted or {}).get(servo["id"], {})) for servo in section["servos"]]
        self.line = DynamixelLine(really, self.plant, baud_rate=section["baud_rate"])
        self._bench = Bench(self.plant, [self.line], self.clock)
        self.bus = DynamixelBus(
            section | {"port": self.line.path}, DriverContext(self.clock, self.robot_file)
        )
        context = DriverContext(self.clock, self.robot_file, self.bus)
        self.encoder, self.torque = DynamixelEncoder(encoder or {}, context), DynamixelTorque({}, context)

    def start(self):
        self.bus.configure()
        self.bus.activate()
        self.torque.activate()

    def read(self):
        self.clock.sleep_until(self.clock.now_s() + TICK_S)
        self.bus.poll(self.clock.now_s() + READ_S)
        return self.bus.sample

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
        self._bench.close()


@contextmanager
def dynamixel_bench(**changes):
    bench = DynamixelBench(**changes)
    try:
        yield bench
    finally:
        bench.close()
