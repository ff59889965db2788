"""A bus of servos: one sync read and one sync write in each tick; counts become SI units here."""

import struct
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from math import exp, isnan, pi
from typing import Any, Generic, Literal

import numpy as np

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.joint_bus import BusEncoder, JointBus, check_one_per_joint
from palpate.robot_io.drivers.servo.feedback import FeedbackReader, FeedbackType
from palpate.robot_io.drivers.servo.joints import ServoBusSettings, ServoJoints, ServoPairs
from palpate.robot_io.drivers.servo.line import ServoLine, examine_line
from palpate.robot_io.errors import DeviceError, InputError, LifecycleError
from palpate.robot_io.examination import Examinable, Finding
from palpate.robot_io.files.file_model import FileModel, Positive
from palpate.robot_io.serial_port import SerialPort
from palpate.robot_io.types import FloatArray, Reading, Status


class ServoBus(JointBus, Examinable, Generic[FeedbackType]):
    """Servos on one half-duplex line, one or two per joint; base of each maker's bus.

    Args:
        steps: Size of one count of each of the m joint servos along the joint axes, shape (3, m):
            position [rad], velocity [rad/s] and torque [N m].

    Attributes:
        sample: Feedback of the last sync read that all servos answered, and the time of its request [s]; None
            before the first.
    """

    def __init__(self, settings: ServoBusSettings[Any], steps: FloatArray, context: DriverContext) -> None:
        check_one_per_joint(context, len(settings.servos), "servos")
        limits = context.robot_file.limits
        self._settings = settings
        self._port = SerialPort(settings.port, settings.baud_rate, context.clock)
        self._ids, self._labels = [servo.id for servo in settings.turning], settings.labels
        self._pairs = ServoPairs(settings, limits)
        ends_rad = zip(limits.position_min_rad, limits.position_max_rad, strict=True)
        middle_rad = [0.5 * (low + high) for low, high in ends_rad]
        self._joints = ServoJoints(settings.turning, self._pairs, middle_rad, steps)
        self._clock = context.clock
        self._reader: FeedbackReader[FeedbackType] | None = None
        self._turns_known = False
        self._powered = False
        self._may_hold = False  # whether the torque may be on; until a command for torque off was confirmed
        self._staged: bytes | None = None
        self.sample: tuple[FeedbackType, float] | None = None
        unknown = Reading(np.full(self.joint_count, np.nan), -np.inf, Status.STALE)
        self.position = self.velocity = self.torque = unknown
        self._goal_fields = [field for servo_id in self._ids for field in (servo_id, 0)]

    # Implemented by each maker.

    _line: ServoLine

    @abstractmethod
    def _examine_servo(self, servo_id: int, label: str) -> Iterable[Finding]:
        """Read the identity of a servo; raise `DeviceError` if it no longer answers, or the port failed."""

    @abstractmethod
    def _prepare_feedback(self) -> FeedbackReader[FeedbackType]:
        """Check the servos against the robot file and prepare reading; their torque is off."""

    @abstractmethod
    def _counts(self, feedback: FeedbackType) -> Sequence[Sequence[float]]:
        """Return positions, velocities and torques of the servos that turn joints, shape (3, m) [counts]."""

    @abstractmethod
    def _is_healthy(self, feedback: FeedbackType) -> bool:
        """Return whether all servos have their settings and no errors; decides in most ticks."""

    @abstractmethod
    def _problem(self, feedback: FeedbackType) -> str | None:
        """Return why some of the feedback cannot be trusted at all, or None."""

    @abstractmethod
    def _goals(self, torque_nm: list[float]) -> tuple[list[int], FloatArray]:
        """Compute goals (m) [servo's unit] for joint torques (n) [N m], and the torques that they exert."""

    # Common to all makers.

    @property
    def joint_count(self) -> int:
        return self._pairs.joint_count

    def configure(self) -> None:
        """Open the port, check the servos against the robot file, and switch their torque off."""
        self._port.open()
        self._reader = self._prepare_feedback()
        self._turns_known = False

    def activate(self) -> None:
        """Write the settings for a run, and read them back."""
        self._line.prepare()
        self._turns_known = False

    def close(self) -> None:
        """Release the port."""
        self._reader = None
        self._port.close()

    def examine(self) -> tuple[Finding, ...]:
        """See `Examinable.examine`; also how far the two servos of a joint stand apart."""
        findings = examine_line(self._settings, self._line, self._examine_servo)
        with suppress(DeviceError):  # servos that do not answer are in other findings
            register = self._line.present_position
            position_counts = [self._line.registers.read(servo_id, register) for servo_id in self._ids]
            zeros = [0] * len(position_counts)
            counts = (position_counts, zeros, zeros)
            if not self._turns_known:
                self._joints.choose_turns(counts)
            findings += self._pairs.examine(self._joints.motion(counts)[0])
        return tuple(findings)

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`: one sync read with its answers, and one sync write."""
        if self._reader is None:
            return None
        goals = self._sync_write([0] * len(self._ids))
        return self._port.duration_s(self._reader.byte_count + len(goals))

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`; either all servos have a new sample, or none.

        Raises:
            DeviceTimeoutError: a servo sent no valid answer in time; the error states its id.
            DeviceError: the port failed; or a servo has restarted, switched its torque off, or has a hardware
                error; or the two servos of a joint differ. The error names the servos.
        """
        if self._reader is None:
            raise LifecycleError("the servos can be read only between configure and close")
        sample = self._reader.read(deadline_s)
        feedback, asked_at_s = sample
        fault_text = ""
        if not self._is_healthy(feedback):
            if problem := self._problem(feedback):
                raise DeviceError(problem)
            servos = zip(self._labels, feedback.fault_texts, strict=True)
            fault_text = "; ".join(f"{label}: {text}" for label, text in servos if text)
        counts = self._counts(feedback)
        if not self._turns_known:
            self._joints.choose_turns(counts)
            self._turns_known = True
        motion = self._joints.motion(counts)
        position_rad, velocity_rad_s, torque_nm = motion[0], motion[1], motion[2]  # faster than iterating
        if self._pairs.joints:
            if disagreement := self._pairs.disagreement(position_rad):
                raise DeviceError(disagreement)
            fault_text = fault_text or self._pairs.torque_difference(torque_nm, asked_at_s) or ""
            position_rad, velocity_rad_s, torque_nm = self._pairs.join_pairs(motion)
        self.sample = sample
        self.position = Reading(position_rad, asked_at_s)
        self.velocity = Reading(velocity_rad_s, asked_at_s)
        self.torque = Reading(torque_nm, asked_at_s, Status.FAULT if fault_text else Status.OK)
        if fault_text:
            raise DeviceError(fault_text)

    def stage(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointBus.stage`; raise `InputError` if a torque is not a number."""
        if not self._powered:
            raise LifecycleError("the drives are off; activate them before the first command")
        wanted_nm = np.asarray(torque_nm, dtype=np.float64).tolist()
        if any(map(isnan, wanted_nm)):
            raise InputError("a motor command is not a number")
        goals, sent_nm = self._goals(wanted_nm)
        self._staged = self._sync_write(goals)
        return sent_nm

    @cached_property
    def _goal_layout(self) -> struct.Struct:
        return struct.Struct("<" + len(self._ids) * ("Bh" if self._line.goal.signed else "BH"))

    def _sync_write(self, goals: list[int]) -> bytes:
        """Return the packet that sends a goal to each servo that turns a joint (m)."""
        goal = self._line.goal
        self._goal_fields[1::2] = goals
        block = self._goal_layout.pack(*self._goal_fields)
        return self._line.dialect.sync_write_block(goal.address, goal.size, block)

    def flush(self, deadline_s: float) -> None:
        """See `Bus.flush`; servos do not answer, but the next poll shows whether they obeyed."""
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
            unreachable_note = self._line.unreachable_note
            raise DeviceError(f"{self._port.path}: {reason}: the torque may still be on; {unreachable_note}")


class ServoEncoderSettings(FileModel):
    """Settings of the velocity measurement."""

    # "servo" takes the servo's own velocity; "difference" takes the low-passed derivative of the position, in
    # which the encoder's steps are visible.
    velocity: Literal["servo", "difference"] = "servo"
    bandwidth_hz: Positive = 60.0  # of the first-order low-pass on the difference [Hz]


class ServoEncoder(BusEncoder):
    """Positions and velocities from a bus of servos."""

    Settings = ServoEncoderSettings
    _settings: ServoEncoderSettings

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        super().__init__(settings, context)
        self._last_position: Reading | None = None
        self._smooth_rad_s: FloatArray = np.full(self.joint_count, np.nan)

    def read_velocity(self) -> Reading:
        reported = self._bus.velocity
        if self._settings.velocity == "servo" or reported.status is not Status.OK:
            return reported
        position = self._bus.position
        last_position, self._last_position = self._last_position, position
        if last_position is None:  # starts from the servo's own velocity
            self._smooth_rad_s = reported.value
        elif last_position is not position:
            elapsed_s = position.sampled_at_s - last_position.sampled_at_s
            raw_rad_s = (position.value - last_position.value) / elapsed_s
            share = 1.0 - exp(-2.0 * pi * self._settings.bandwidth_hz * elapsed_s)
            self._smooth_rad_s = self._smooth_rad_s + share * (raw_rad_s - self._smooth_rad_s)
        return Reading(self._smooth_rad_s, reported.sampled_at_s, reported.status)
