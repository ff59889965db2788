"""What the loop's tests put around it: an arm of three free masses with faults on demand, a log, tasks."""

from collections.abc import Callable

import numpy as np

from control.phases import Phase
from control.task import TaskEvent, TaskOutput
from robot_io.clock import Clock, SimulatedClock
from robot_io.guard import Guard
from robot_io.interfaces import Bus, ForceSensor, JointEncoder, JointTorque
from robot_io.limits import Limits, SafeState
from robot_io.robot import Robot
from robot_io.types import Command, Reading

JOINTS = 3
INERTIA_KGM2 = 0.02
AGE_LIMIT_S = 0.005
STOP_TIME_S = 0.05
RATE_HZ = 1000.0


class FreeMasses(Bus):
    """Three joints without gravity or friction, integrated at each poll; every part can be made to fail."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.position_rad = np.zeros(JOINTS)
        self.velocity_rad_s = np.zeros(JOINTS)
        self.torque_nm = np.zeros(JOINTS)
        self.staged_nm = np.zeros(JOINTS)
        self.force_n = 0.0
        self.time_s = clock.now_s()
        self.force_at_s = self.time_s
        self.sent_nm: list[np.ndarray] = []
        self.deactivations = 0
        self.active = False
        self.frozen_force = False
        self.poll_error: Exception | None = None
        self.flush_error: Exception | None = None
        self.deactivation_error: Exception | None = None
        self.on_poll: Callable[[], None] = lambda: None

    def activate(self) -> None:
        self.active = True

    def deactivate(self) -> None:
        self.deactivations += 1
        self.torque_nm = np.zeros(JOINTS)
        if self.deactivation_error:
            raise self.deactivation_error
        self.active = False

    def poll(self, deadline_s: float) -> None:
        self.on_poll()
        elapsed_s = self.clock.now_s() - self.time_s
        self.velocity_rad_s = self.velocity_rad_s + self.torque_nm / INERTIA_KGM2 * elapsed_s
        self.position_rad = self.position_rad + self.velocity_rad_s * elapsed_s
        if self.poll_error:
            raise self.poll_error
        self.time_s += elapsed_s
        if not self.frozen_force:
            self.force_at_s = self.time_s

    def flush(self, deadline_s: float) -> None:
        if self.flush_error:
            raise self.flush_error
        self.torque_nm = self.staged_nm
        self.sent_nm.append(self.staged_nm)


class Encoder(JointEncoder):
    def __init__(self, masses: FreeMasses) -> None:
        self.masses = masses

    joint_count = JOINTS

    def read_position(self) -> Reading:
        return Reading(self.masses.position_rad, self.masses.time_s)

    def read_velocity(self) -> Reading:
        return Reading(self.masses.velocity_rad_s, self.masses.time_s)


class Drives(JointTorque):
    def __init__(self, masses: FreeMasses) -> None:
        self.masses = masses

    joint_count = JOINTS

    def read_torque(self) -> Reading:
        return Reading(self.masses.torque_nm, self.masses.time_s)

    def stage_torque(self, torque_nm):
        self.masses.staged_nm = torque_nm
        return torque_nm


class Force(ForceSensor):
    def __init__(self, masses: FreeMasses) -> None:
        self.masses = masses

    def read_force(self) -> Reading:
        return Reading(np.array([self.masses.force_n]), self.masses.force_at_s)


class Arm:
    """A robot, its plant, its guard and its clock, configured."""

    def __init__(self, clock: Clock | None = None, **limits) -> None:
        self.clock = clock or SimulatedClock()
        self.masses = FreeMasses(self.clock)
        self.robot = Robot(
            Encoder(self.masses),
            Drives(self.masses),
            Force(self.masses),
            {"line": self.masses},
            self.clock,
            "masses",
        )
        self.robot.configure()
        per_joint = {
            "torque_nm": 10.0,
            "torque_rate_nm_s": 1e5,
            "position_min_rad": -3.0,
            "position_max_rad": 3.0,
            "velocity_rad_s": 20.0,
            "tracking_rad": 1.0,
        }
        values = {name: (value,) * JOINTS for name, value in per_joint.items()}
        ages = dict.fromkeys(("encoder_age_s", "torque_age_s", "force_age_s"), AGE_LIMIT_S)
        self.guard = Guard(
            Limits(**{**values, **ages, "force_n": 30.0, **limits}),
            SafeState(damping_nms_rad=(1.0,) * JOINTS, stop_time_s=STOP_TIME_S),
            JOINTS,
        )


class MemoryLog:
    """A log that keeps everything, and fails on demand."""

    def __init__(self) -> None:
        self.records: list[np.void] = []
        self.events: list[tuple[float, str, str]] = []
        self.dropped = 0
        self.failure: str | None = None
        self.error: Exception | None = None

    def append(self, stream_name, record) -> None:
        assert stream_name == "tick"
        if self.error:
            raise self.error
        self.records.append(record.copy())

    def event(self, time_s, kind, text, data=None) -> None:
        self.events.append((time_s, kind, text))

    def column(self, name: str) -> np.ndarray:
        return np.array([record[name] for record in self.records])

    def texts(self, kind: str) -> list[str]:
        return [text for _, event_kind, text in self.events if event_kind == kind]


class Swing:
    """Moves the joints with a constant torque, and may fail or end at a given tick."""

    def __init__(
        self, *, done_at: int | None = None, fail_at: int | None = None, torque_nm: float = 0.1
    ) -> None:
        self.done_at, self.fail_at, self.torque_nm = done_at, fail_at, torque_nm
        self.steps = 0
        self.dts_s: list[float] = []
        self.started_from = None

    def start(self, measurement) -> None:
        self.started_from = measurement

    def step(self, measurement, dt_s) -> TaskOutput:
        self.steps += 1
        self.dts_s.append(dt_s)
        if self.steps == self.fail_at:
            raise ZeroDivisionError("the controller has a bug")
        zeros = np.zeros(3)
        return TaskOutput(
            command=Command(np.full(JOINTS, self.torque_nm)),
            reference_position_rad=measurement.joint_position_rad,
            reference_velocity_rad_s=measurement.joint_velocity_rad_s,
            tip_position_world_m=zeros,
            tip_velocity_world_m_s=zeros,
            press_direction_world=np.array([0.0, 0.0, -1.0]),
            desired_force_n=2.0,
            phase=Phase.LOADING,
            run=4,
            done=self.steps == self.done_at,
            events=(TaskEvent("touch", "touched"),) if self.steps == 3 else (),
        )
