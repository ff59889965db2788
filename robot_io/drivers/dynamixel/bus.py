"""A bus of Dynamixel servos: one sync read and one sync write in each tick; counts become SI units here."""

from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from robot_io.driver import DriverContext
from robot_io.drivers.dynamixel import protocol
from robot_io.drivers.dynamixel.examination import examine_servos
from robot_io.drivers.dynamixel.feedback import Feedback, FeedbackReader, feedback_problem, hardware_problem
from robot_io.drivers.dynamixel.servos import ServoIdentity, ServoLine
from robot_io.drivers.dynamixel.settings import DynamixelSettings, ServoSettings
from robot_io.drivers.dynamixel.tables import GOAL_CURRENT, POSITION_STEP_RAD, VELOCITY_STEP_RAD_S
from robot_io.errors import DeviceError, LifecycleError
from robot_io.examination import Examinable, Finding
from robot_io.interfaces import Bus
from robot_io.serial_port import SerialPort
from robot_io.types import FloatArray, Status

_TURN_RAD = 2.0 * np.pi


class ServoJoints:
    """Converts what servos say and are told.

    A servo counts over several turns, but starts within one after power-up. `choose_turns` settles which turn
    of the joint that is; from then on the angle is continuous.

    Args:
        servos: one per joint.
        middle_rad: of each joint's range (n) [rad]; positions more than half a turn away are not told apart.
    """

    def __init__(self, servos: Sequence[ServoSettings], middle_rad: Sequence[float]) -> None:
        self._middle_rad = np.array(middle_rad)
        self._zero_rad = np.array([servo.zero_rad for servo in servos])
        direction = np.array([-1.0 if servo.reversed else 1.0 for servo in servos])
        torque_step_nm = np.array(
            [
                (servo.torque_constant_nm_a or servo.servo_model.torque_constant_nm_a)
                * servo.servo_model.current_step_a
                for servo in servos
            ]
        )
        steps = (direction * POSITION_STEP_RAD, direction * VELOCITY_STEP_RAD_S, direction * torque_step_nm)
        self._steps = np.array(steps)  # (3, n): of position, velocity and torque
        self._offsets = np.zeros_like(self._steps)
        self._torque_steps_nm: list[float] = self._steps[2].tolist()

    def choose_turns(self, feedback: Sequence[Feedback]) -> None:
        """Take the servos to be in the turn nearest to the middle of their joints' range."""
        self._offsets[0] = self._zero_rad
        off_rad = self._middle_rad - self.motion(feedback)[0]
        self._offsets[0] += _TURN_RAD * np.round(off_rad / _TURN_RAD)

    def motion(self, feedback: Sequence[Feedback]) -> FloatArray:
        """Positions [rad], velocities [rad/s] by the servos, torques [N m] by the currents, shape (3, n).

        All are positive along the joint axes; converted at once, as this runs in every tick.
        """
        _, _, _, current, velocity, position, _ = zip(*feedback, strict=True)
        values: FloatArray = np.array((position, velocity, current), dtype=np.float64)
        values *= self._steps
        values += self._offsets
        return values

    def current_counts(self, torque_nm: FloatArray, largest: Sequence[int]) -> list[int]:
        """Goal currents (n) for joint torques (n) [N m], cut at the `largest` counts (n)."""
        return [
            min(max(round(torque / step), -most), most)
            for torque, step, most in zip(torque_nm.tolist(), self._torque_steps_nm, largest, strict=True)
        ]

    def torque_of_counts(self, counts: Sequence[int]) -> FloatArray:
        """The joint torques (n) [N m] of goal currents (n)."""
        torque: FloatArray = counts * self._steps[2]
        return torque


class ServoSample(NamedTuple):
    """What one sync read brought; positive along the joint axes."""

    sampled_at_s: float  # when the servos were asked [s]
    position_rad: FloatArray  # shape (n,) [rad]
    velocity_rad_s: FloatArray  # as the servos derive it, shape (n,) [rad/s]
    torque_nm: FloatArray  # by the motor currents, shape (n,) [N m]
    torque_status: Status  # FAULT if a servo has a hardware error


class DynamixelBus(Bus, Examinable):
    """Servos of the X series in current control, Protocol 2.0.

    Attributes:
        sample: what the last sync read brought that was answered by all, or None before the first.
    """

    name: ClassVar[str] = "dynamixel_bus"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._settings = context.settings_as(DynamixelSettings, settings)
        self._clock = context.clock
        self._port = SerialPort(self._settings.port, self._settings.baud_rate, context.clock)
        self._line = ServoLine(self._settings, self._port, context.clock)
        self._ids = [servo.id for servo in self._settings.servos]
        limits = context.robot_file.limits
        middle_rad = 0.5 * (np.array(limits.position_min_rad) + np.array(limits.position_max_rad))
        self._middle_rad = np.resize(middle_rad, len(self._ids))
        self._joints = ServoJoints(self._settings.servos, self._middle_rad.tolist())
        self._largest_current = [servo.servo_model.largest_current for servo in self._settings.servos]
        self._reader: FeedbackReader | None = None
        self._turns_known = False
        self._powered = False
        self._staged: bytes | None = None
        self.sample: ServoSample | None = None

    @property
    def joint_count(self) -> int:
        return len(self._ids)

    @property
    def identities(self) -> tuple[ServoIdentity, ...]:
        """Who answered when the bus was configured."""
        return self._line.identities

    def configure(self) -> None:
        """Open the port, see that the servos are those of the robot file, and switch their torque off."""
        self._port.open()
        self._line.identify()
        self._line.prepare_feedback()
        self._reader = self._line.feedback_reader()
        self._largest_current = [identity.current_limit for identity in self.identities]
        self._turns_known = False

    def activate(self) -> None:
        """Set current control, return delay and watchdog, and read them back."""
        self._line.prepare_torque()
        self._turns_known = False

    def close(self) -> None:
        """Let the port go."""
        self._reader = None
        self._port.close()

    def examine(self) -> tuple[Finding, ...]:
        """See `Examinable.examine`; also finds servos under other ids and at another baud rate."""
        return tuple(examine_servos(self._settings, self._port, self._clock))

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`: one sync read with its answers, and one sync write."""
        if self._reader is None:
            return None
        goals = protocol.sync_write(GOAL_CURRENT.address, dict.fromkeys(self._ids, bytes(2)))
        waiting_s = self._settings.return_delay_s * len(self._ids)
        return waiting_s + self._port.duration_s(self._reader.byte_count + len(goals))

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`; the samples are of all servos or of none.

        DeviceTimeoutError: a servo did not answer properly in time, by id; DeviceError: the port failed, a
        servo has restarted, let go or has a hardware error, by name.
        """
        if self._reader is None:
            raise LifecycleError("the servos can be read from configure to close")
        feedback, asked_at_s = self._reader.read(deadline_s)
        problem = feedback_problem(feedback, self._ids, self._settings.watchdog, powered=self._powered)
        if problem:
            raise DeviceError(problem)
        hardware = hardware_problem(feedback, self._ids)
        self._take(feedback, asked_at_s, Status.FAULT if hardware else Status.OK)
        if hardware:
            raise DeviceError(hardware)

    def _take(self, feedback: list[Feedback], asked_at_s: float, torque_status: Status) -> None:
        joints = self._joints
        if not self._turns_known:
            joints.choose_turns(feedback)
            self._turns_known = True
        position_rad, velocity_rad_s, torque_nm = joints.motion(feedback)
        self.sample = ServoSample(asked_at_s, position_rad, velocity_rad_s, torque_nm, torque_status)

    def stage(self, torque_nm: FloatArray) -> FloatArray:
        """Keep torques (n) [N m] for the next flush; returns what the currents' range and step make of them.

        LifecycleError: the torque is off.
        """
        if not self._powered:
            raise LifecycleError("the drives are off: activate them before the first command")
        counts = self._joints.current_counts(torque_nm, self._largest_current)
        data = {
            servo_id: GOAL_CURRENT.encode(count) for servo_id, count in zip(self._ids, counts, strict=True)
        }
        self._staged = protocol.sync_write(GOAL_CURRENT.address, data)
        return self._joints.torque_of_counts(counts)

    def flush(self, deadline_s: float) -> None:
        """See `Bus.flush`; nobody answers, but the next poll shows whether the servos still obey."""
        if self._staged is not None:
            staged, self._staged = self._staged, None
            self._port.write(staged)

    def torque_on(self) -> None:
        """Torque on, at zero. DeviceError: a servo refused."""
        self._line.switch_on()
        self._powered = True

    def torque_off(self) -> None:
        """Torque off, and a staged command is dropped; does nothing on a port that was never opened.

        DeviceError: some servos did not confirm it.
        """
        self._staged = None
        powered, self._powered = self._powered, False
        if self._port.is_open:
            self._line.switch_off()
        elif powered:
            reason = self._port.failure or "the port is closed"
            raise DeviceError(
                f"{self._port.path}: {reason}: torque not known to be off; {self._line.last_resort}"
            )
