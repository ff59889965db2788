"""A robot for tests, written against robot_io's interfaces alone: a small planar arm above a spring.

The arm moves in the world x-z plane, joint axes along +y, base at the origin. Links are massless bars with
rotational inertia: in the absolute angles phi = cumsum(q) the dynamics are diagonal, I_i phi''_i = Q_i.
`URDF` describes the same arm for model-based control. There is no gravity. A horizontal surface pushes the
tip up with k * depth + c * rate, never pulling.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from palpate.robot_io.clock import Clock, SimulatedClock
from palpate.robot_io.driver import DriverCatalog, DriverContext
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError
from palpate.robot_io.files.file_model import FileModel, NotNegative, Number, Positive
from palpate.robot_io.interfaces import Bus, Component, ForceSensor, JointEncoder, JointTorque
from palpate.robot_io.robot import Robot, build_robot
from palpate.robot_io.robot_file import RobotFile, parse_robot_file
from palpate.robot_io.types import FloatArray, Reading, Status

LINK_LENGTHS_M = np.array([0.35, 0.30, 0.10])
LINK_INERTIAS_KG_M2 = np.array([0.10, 0.05, 0.01])
SUBSTEP_S = 0.25e-3
MAX_TORQUE_NM = 20.0
TORQUE_STEP_NM = 1e-3
WATCHDOG_S = 0.05  # the drives let go when nothing was sent for so long

ROBOT_YAML = """\
name: mock
urdf: mock.urdf
tip_frame: tip
sensor_axis_tip: [1, 0, 0]
control_rate_hz: 1000
buses:
  world: {driver: mock_bus}
encoder: {driver: mock_encoder, bus: world}
torque: {driver: mock_torque, bus: world}
force: {driver: mock_force, bus: world}
home_rad: [-1.275, 1.391, 1.455]   # tip at x 0.4 m, z 0.2 m, pointing down
limits:
  torque_nm: [15, 15, 8]
  torque_rate_nm_s: [3000, 3000, 3000]
  position_min_rad: [-2.6, -0.2, -2.6]
  position_max_rad: [0.4, 2.6, 2.8]
  velocity_rad_s: [4, 6, 8]
  force_n: 30
  tracking_rad: [0.3, 0.3, 0.3]
  encoder_age_s: 0.005
  torque_age_s: 0.005
  force_age_s: 0.005
safe_state: {damping_nms_rad: [2, 1, 0.2], stop_time_s: 0.2}
"""


def _link_urdf(index: int, inertia: float, length: float) -> str:
    parent, offset = ("base", 0.0) if index == 1 else (f"link_{index - 1}", LINK_LENGTHS_M[index - 2])
    return f"""
  <link name="link_{index}"><inertial><mass value="1e-6"/>
    <inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="joint_{index}" type="revolute"><parent link="{parent}"/><child link="link_{index}"/>
    <origin xyz="{offset} 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3.2" upper="3.2" effort="{MAX_TORQUE_NM}" velocity="10"/></joint>"""


URDF = f"""<robot name="mock"><link name="base"/>
{"".join(_link_urdf(i + 1, LINK_INERTIAS_KG_M2[i], LINK_LENGTHS_M[i]) for i in range(3))}
  <link name="tip"/>
  <joint name="tip_joint" type="fixed"><parent link="link_3"/><child link="tip"/>
    <origin xyz="{LINK_LENGTHS_M[2]} 0 0"/></joint>
</robot>
"""


class MockPlant:
    """The arm and what it touches; `advance` integrates up to a time with the torque held constant."""

    def __init__(self, position_rad: FloatArray, stiffness_n_m: float, damping_n_s_m: float) -> None:
        self.time_s = 0.0
        self.angle_rad = np.cumsum(position_rad)  # absolute angles phi
        self.rate_rad_s = np.zeros(3)
        self.torque_nm = np.zeros(3)
        self.stiffness_n_m = stiffness_n_m
        self.damping_n_s_m = damping_n_s_m
        self.surface_height_m = 0.15
        self.hand_force_n = 0.0  # a hand that pushes the tip up, whether it touches the object or not

    @property
    def position_rad(self) -> FloatArray:
        return np.diff(self.angle_rad, prepend=0.0)

    @property
    def velocity_rad_s(self) -> FloatArray:
        return np.diff(self.rate_rad_s, prepend=0.0)

    @property
    def tip_height_m(self) -> float:
        return float(-LINK_LENGTHS_M @ np.sin(self.angle_rad))

    @property
    def lift_n(self) -> float:
        """Force on the tip along world +z [N]."""
        depth_m = self.surface_height_m - self.tip_height_m
        if depth_m <= 0.0:
            return self.hand_force_n
        rate_m_s = float(LINK_LENGTHS_M * np.cos(self.angle_rad) @ self.rate_rad_s)
        spring_n = self.stiffness_n_m * depth_m + self.damping_n_s_m * rate_m_s
        return max(0.0, spring_n) + self.hand_force_n

    @property
    def compression_n(self) -> float:
        """What the sensor feels: the lift along the tool, which points along the last link."""
        return self.lift_n * float(np.sin(self.angle_rad[2]))

    def advance(self, time_s: float) -> None:
        steps = int(np.ceil((time_s - self.time_s) / SUBSTEP_S - 1e-9))
        for _ in range(steps):
            step_s = (time_s - self.time_s) / steps
            generalised_nm = self.torque_nm - np.append(self.torque_nm[1:], 0.0)
            generalised_nm -= self.lift_n * LINK_LENGTHS_M * np.cos(self.angle_rad)
            self.rate_rad_s = self.rate_rad_s + step_s * generalised_nm / LINK_INERTIAS_KG_M2
            self.angle_rad = self.angle_rad + step_s * self.rate_rad_s
        self.time_s = max(self.time_s, time_s)


@dataclass
class MockFaults:
    """What is wrong with the mock; devices are called encoder, torque, force, bus."""

    silent: set[str] = field(default_factory=set)  # no new samples
    not_a_number: set[str] = field(default_factory=set)
    status: dict[str, Status] = field(default_factory=dict)
    refuse: set[tuple[str, str]] = field(default_factory=set)  # (device, lifecycle step) that fails
    poll_takes_s: float = 0.0
    unplugged: bool = False


class BusSettings(FileModel):
    stiffness_n_m: Positive = 1000.0
    damping_n_s_m: NotNegative = 20.0
    start_rad: tuple[Number, Number, Number] | None = None


class NotedLifecycle:
    """Counts its lifecycle on the bus, and fails there when it is told to."""

    device: str
    bus: "MockBus"

    def configure(self) -> None:
        self.bus.note(self.device, "configure")

    def activate(self) -> None:
        self.bus.note(self.device, "activate")

    def verify(self) -> None:
        self.bus.note(self.device, "verify")

    def deactivate(self) -> None:
        self.bus.note(self.device, "deactivate")

    def close(self) -> None:
        self.bus.note(self.device, "close")


class MockDevice(NotedLifecycle, Component):
    """One device of the bus."""

    def __init__(self, settings: object, context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self.bus = context.bus_as(MockBus)

    def read(self) -> Reading:
        return self.bus.readings[self.device]


class MockBus(NotedLifecycle, Bus):
    """Owns the plant; samples it when polled, drives it when flushed."""

    name, device = "mock_bus", "bus"

    def __init__(self, settings: object, context: DriverContext) -> None:
        chosen = context.settings_as(BusSettings, settings)
        self.bus, self.clock = self, context.clock
        start_rad = np.array(chosen.start_rad or context.robot_file.home_rad)
        self.plant = MockPlant(start_rad, chosen.stiffness_n_m, chosen.damping_n_s_m)
        self.plant.time_s = self.clock.now_s()
        self.faults = MockFaults()
        self.calls: list[tuple[str, str]] = []
        self.polls = 0
        nothing = np.full(3, np.nan)
        self.readings = {
            key: Reading(nothing[:1] if key == "force" else nothing, -np.inf, Status.STALE)
            for key in ("encoder", "velocity", "torque", "force")
        }
        self.staged_nm = np.zeros(3)
        self.powered = False
        self._fed_s = -np.inf

    def note(self, device: str, step: str) -> None:
        self.calls.append((device, step))
        if (device, step) in self.faults.refuse:
            raise DeviceError(f"mock {device} refuses to {step}")
        if device == "torque":
            self.powered = step == "activate"
            self.staged_nm = np.zeros(3)
            self._drive()

    def poll(self, deadline_s: float) -> None:
        self.polls += 1
        self._check_plug()
        if self.faults.poll_takes_s:
            done_s = self.clock.now_s() + self.faults.poll_takes_s
            self.clock.sleep_until(min(done_s, deadline_s))
            if done_s > deadline_s:
                raise DeviceTimeoutError("mock bus: no answer before the deadline")
        self._let_time_pass()
        plant = self.plant
        self._sample("encoder", plant.position_rad)
        self._sample("velocity", plant.velocity_rad_s)
        self._sample("torque", plant.torque_nm.copy())
        self._sample("force", np.array([plant.compression_n]))

    def flush(self, deadline_s: float) -> None:
        self._check_plug()
        self._drive()
        self._fed_s = self.clock.now_s()

    def _check_plug(self) -> None:
        if self.faults.unplugged:
            raise DeviceError("mock bus: unplugged")

    def _let_time_pass(self) -> None:
        """Up to now; without commands the drives let go on their own."""
        now_s = self.clock.now_s()
        if now_s > self._fed_s + WATCHDOG_S:
            self.plant.advance(max(self._fed_s + WATCHDOG_S, self.plant.time_s))
            self.plant.torque_nm = np.zeros(3)
        self.plant.advance(now_s)

    def _drive(self) -> None:
        self._let_time_pass()
        self.plant.torque_nm = self.staged_nm if self.powered else np.zeros(3)

    def _sample(self, key: str, value: FloatArray) -> None:
        device = "encoder" if key == "velocity" else key
        if device in self.faults.silent:
            old = self.readings[key]
            self.readings[key] = Reading(old.value, old.sampled_at_s, Status.STALE)
            return
        if device in self.faults.not_a_number:
            value = np.full_like(value, np.nan)
        self.readings[key] = Reading(value, self.plant.time_s, self.faults.status.get(device, Status.OK))


class MockEncoder(MockDevice, JointEncoder):
    name = "mock_encoder"
    device = "encoder"
    joint_count = 3

    def read_position(self) -> Reading:
        return self.read()

    def read_velocity(self) -> Reading:
        return self.bus.readings["velocity"]


class MockTorque(MockDevice, JointTorque):
    name = "mock_torque"
    device = "torque"
    joint_count = 3

    def read_torque(self) -> Reading:
        return self.read()

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        in_range = np.clip(torque_nm, -MAX_TORQUE_NM, MAX_TORQUE_NM)
        self.bus.staged_nm = TORQUE_STEP_NM * np.round(in_range / TORQUE_STEP_NM)
        return self.bus.staged_nm.copy()


class MockForce(MockDevice, ForceSensor):
    name = "mock_force"
    device = "force"

    def read_force(self) -> Reading:
        return self.read()


def mock_robot_file(text: str = ROBOT_YAML) -> RobotFile:
    return parse_robot_file(text, "mock.yaml")


def build_mock_robot(clock: Clock | None = None, text: str = ROBOT_YAML) -> Robot:
    """A mock robot in state NEW, on its own simulated clock unless one is given."""
    return build_robot(mock_robot_file(text), DriverCatalog("tests.mock_robot"), clock or SimulatedClock())


def mock_bus(robot: Robot) -> MockBus:
    """The bus of a mock robot, with its `plant` and its `faults`."""
    bus = robot.buses["world"]
    if not isinstance(bus, MockBus):
        raise TypeError(f"not a mock robot: {bus}")
    return bus


def write_mock_files(folder: Path) -> Path:
    """Robot file and URDF in `folder`; returns the robot file's path."""
    (folder / "mock.urdf").write_text(URDF, encoding="utf-8")
    path = folder / "mock.yaml"
    path.write_text(ROBOT_YAML, encoding="utf-8")
    return path
