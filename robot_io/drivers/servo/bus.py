"""A bus of servos: one sync read and one sync write in each tick; counts become SI units here."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from robot_io.driver import DriverContext
from robot_io.drivers.bus_devices import JointBus
from robot_io.drivers.servo.feedback import FeedbackReader
from robot_io.drivers.servo.joints import ServoJoints, ServoSample, middle_of
from robot_io.drivers.servo.line import ServoLine
from robot_io.drivers.servo.pairs import ServoPairs
from robot_io.drivers.servo.settings import ServoBusSettings
from robot_io.errors import DeviceError, InputError, LifecycleError
from robot_io.examination import Examinable, Finding
from robot_io.serial_port import SerialPort
from robot_io.types import FloatArray, Reading, Status


class ServoBus(JointBus, Examinable):
    """Servos on one half-duplex line, one or two per joint; a maker's bus adds what is its own.

    Attributes:
        sample: what the last sync read brought that was answered by all, or None before the first.
    """

    def __init__(self, settings: ServoBusSettings[Any], steps: FloatArray, context: DriverContext) -> None:
        limits = context.robot_file.limits
        self._port = SerialPort(settings.port, settings.baud_rate, context.clock)
        self._ids, self._labels = [servo.id for servo in settings.turning], settings.labels
        self._pairs = ServoPairs(settings, limits)
        middle_rad = middle_of(limits.position_min_rad, limits.position_max_rad, len(settings.servos))
        self._joints = ServoJoints(settings.turning, self._pairs, middle_rad, steps)
        self._clock = context.clock
        self._reader: FeedbackReader[Any] | None = None
        self._turns_known = False
        self._powered = False
        self._may_hold = False  # until the servos have been told to let go, however often that fails
        self._staged: bytes | None = None
        self.sample: ServoSample | None = None
        unknown = Reading(np.full(self.joint_count, np.nan), -np.inf, Status.STALE)
        self.position = self.velocity = self.torque = unknown

    # What a maker adds.

    _line: ServoLine

    @abstractmethod
    def _examine_servos(self) -> list[Finding]:
        """What each servo says of itself. DeviceError: the port failed."""

    @abstractmethod
    def _prepare_feedback(self) -> FeedbackReader[Any]:
        """See that the servos are those of the robot file, and make ready to read; their torque is off."""

    @abstractmethod
    def _counts(self, feedback: Sequence[Any]) -> Sequence[Sequence[int]]:
        """Position, velocity and torque of all servos that turn joints, shape (3, m)."""

    @abstractmethod
    def _problem(self, feedback: Sequence[Any]) -> str | None:
        """Why some of the feedback cannot be trusted at all, or None."""

    @abstractmethod
    def _goals(self, torque_nm: FloatArray) -> tuple[bytes, FloatArray]:
        """The sync write for joint torques (n) [N m], and what they become (n) [N m]."""

    # What is common.

    @property
    def joint_count(self) -> int:
        return self._pairs.joint_count

    def configure(self) -> None:
        """Open the port, see that the servos are those of the robot file, and switch their torque off."""
        self._port.open()
        self._reader = self._prepare_feedback()
        self._turns_known = False

    def activate(self) -> None:
        """Set what a run needs, and read it back."""
        self._line.prepare()
        self._turns_known = False

    def close(self) -> None:
        """Let the port go."""
        self._reader = None
        self._port.close()

    def examine(self) -> tuple[Finding, ...]:
        """See `Examinable.examine`; also how far the two servos of a joint stand apart."""
        return (*self._examine_servos(), *self._examine_pairs())

    def _examine_pairs(self) -> list[Finding]:
        try:
            shown = [self._line.registers.read(one, self._line.present_position) for one in self._ids]
        except DeviceError:
            return []  # who does not answer has been found already
        counts = (shown, [0] * len(shown), [0] * len(shown))
        if not self._turns_known:
            self._joints.choose_turns(counts)
        return self._pairs.examine(self._joints.motion(counts)[0])

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`: one sync read with its answers, and one sync write."""
        if self._reader is None:
            return None
        goal = self._line.goal
        goals = self._line.dialect.sync_write(goal.address, dict.fromkeys(self._ids, bytes(goal.size)))
        return self._port.duration_s(self._reader.byte_count + len(goals))

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`; the samples are of all servos or of none.

        DeviceTimeoutError: a servo did not answer properly in time, by id; DeviceError: the port failed, a
        servo has restarted, let go or has a hardware error, or two of a joint differ, by name.
        """
        if self._reader is None:
            raise LifecycleError("the servos can be read from configure to close")
        feedback, asked_at_s = self._reader.read(deadline_s)
        problem = self._problem(feedback)
        if problem:
            raise DeviceError(problem)
        motion = self._motion(feedback)
        problem = self._pairs.disagreement(motion[0])
        if problem:
            raise DeviceError(problem)
        strife = self._pairs.strife(motion[2], asked_at_s)
        hardware = self._hardware_problem(feedback) or strife
        position_rad, velocity_rad_s, torque_nm = self._pairs.joined(motion)
        self.sample = ServoSample(asked_at_s, position_rad, velocity_rad_s, torque_nm, motion)
        self.position = Reading(position_rad, asked_at_s)
        self.velocity = Reading(velocity_rad_s, asked_at_s)
        self.torque = Reading(torque_nm, asked_at_s, Status.FAULT if hardware else Status.OK)
        if hardware:
            raise DeviceError(hardware)

    def _hardware_problem(self, feedback: Sequence[Any]) -> str:
        """Which servos say that something is wrong with them, or nothing; their positions are sound."""
        said = zip(self._labels, feedback, strict=True)
        return "; ".join(f"{label}: {servo.complaint}" for label, servo in said if servo.complaint)

    def _motion(self, feedback: Sequence[Any]) -> FloatArray:
        """Positions [rad], velocities [rad/s] and torques [N m] of the servos along the joint axes (3, m)."""
        counts = self._counts(feedback)
        if not self._turns_known:
            self._joints.choose_turns(counts)
            self._turns_known = True
        return self._joints.motion(counts)

    def stage(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointBus.stage`. InputError: a torque is not a number."""
        if not self._powered:
            raise LifecycleError("the drives are off: activate them before the first command")
        if np.isnan(torque_nm).any():
            raise InputError("a motor command is not a number")
        self._staged, torque_nm = self._goals(np.asarray(torque_nm, dtype=np.float64))
        return torque_nm

    def flush(self, deadline_s: float) -> None:
        """See `Bus.flush`; nobody answers, but the next poll shows whether the servos still obey."""
        if self._staged is not None:
            staged, self._staged = self._staged, None
            self._port.write(staged)

    def power_on(self) -> None:
        self._may_hold = True
        self._switch_on()
        self._pairs.restart()
        self._powered = True

    def _switch_on(self) -> None:
        self._line.switch_on()

    def power_off(self) -> None:
        """See `JointBus.power_off`; does nothing on a port that was never opened."""
        self._staged, self._powered = None, False
        if self._port.is_open:
            self._line.switch_off()
            self._may_hold = False
        elif self._may_hold:
            reason = self._port.failure or "the port is closed"
            last_resort = self._line.last_resort
            raise DeviceError(f"{self._port.path}: {reason}: torque not known to be off; {last_resort}")
