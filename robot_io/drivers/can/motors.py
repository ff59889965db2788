"""Joints driven by motors on a CAN bus: the part that all motor protocols share."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from math import inf
from typing import Annotated

import numpy as np
from pydantic import StrictBool

from robot_io.driver import DriverContext
from robot_io.drivers.bus_devices import JointBus, check_one_per_joint
from robot_io.drivers.can.line import CanFrame, CanLine, CanLineSettings
from robot_io.errors import DeviceError, DeviceTimeoutError, LifecycleError, ProtocolError
from robot_io.examination import Examinable, Finding, fail, warn
from robot_io.files.file_model import FileModel, Number, ZeroAngle, between
from robot_io.types import FloatArray, Reading, Status

_SILENT_SHARE = 0.5  # of the age limit; said from then on, so that it is known when the limit is reached
_FRAME_BITS = 47  # of a frame with an 11 bit id and the gap after it, beside its data (ISO 11898-1)
_EXTENSION_BITS = 20  # more with a 29 bit id
_USUAL_BITRATE = 1_000_000  # where the adapter was set up before, and does not say how
_LOOK_S = 1e-3  # how often to look while waiting for an answer
_MOST_FOREIGN = 20  # ids that are listed


class MotorMounting(FileModel):
    """How a motor moves its joint: joint angle = zero_rad + sign * shaft angle / gear_ratio."""

    # Turns of what the drive reports for one turn of the joint.
    gear_ratio: Annotated[Number, between(1e-3, 1e4, "turns")] = 1.0
    reversed: StrictBool = False  # whether a positive shaft angle turns the joint backwards
    zero_rad: ZeroAngle = 0.0  # joint angle where the drive reports zero [rad]

    @property
    def signed_ratio(self) -> float:
        """Shaft turns for one turn of the joint, negative if reversed."""
        return -self.gear_ratio if self.reversed else self.gear_ratio

    def joint_angle_rad(self, shaft_rad: float) -> float:
        """Joint angle [rad] of a shaft angle [rad]."""
        return self.zero_rad + shaft_rad / self.signed_ratio


class MotorBus(JointBus, Examinable):
    """Motors on one CAN bus, one per joint from base to tip.

    A protocol says how a frame changes a joint (`_take`), how a torque is sent, and how motors are powered.
    """

    def __init__(
        self, line: CanLineSettings, mountings: Sequence[MotorMounting], context: DriverContext
    ) -> None:
        check_one_per_joint(context, len(mountings), "motors")
        self._clock = context.clock
        self._mountings = tuple(mountings)
        self._limits = context.robot_file.limits
        self.line = CanLine(line, context.clock)
        n = len(mountings)
        self._position_rad, self._velocity_rad_s, self._torque_nm = ([float("nan")] * n for _ in range(3))
        self._motion_at_s, self._torque_at_s = [-inf] * n, [-inf] * n
        self._at_range_end = [False] * n
        self._motion_is_wrong = [False] * n  # the motor itself says that its encoder has failed
        self._last_problem = [""] * n
        self._foreign_ids: set[int] = set()
        self._staged: list[CanFrame] = []
        self._powered = False
        self._publish([""] * n)

    @property
    def joint_count(self) -> int:
        return len(self._mountings)

    # What a protocol adds.

    @abstractmethod
    def motor_label(self, joint: int) -> str:
        """What to call the motor of `joint` (from 0) in messages."""

    @abstractmethod
    def _switch_off(self) -> None:
        """Take the torque off all motors, on a line that is open. DeviceError: one did not confirm."""

    @abstractmethod
    def _take(self, frame: CanFrame, at_s: float) -> bool:
        """Keep what a frame says of a joint; False if it is not for us.

        ProtocolError: it comes from one of our motors but is not what the protocol allows.
        """

    @abstractmethod
    def _joint_of(self, frame: CanFrame) -> int | None:
        """Which joint a frame comes from."""

    @abstractmethod
    def _encode_torque(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        """The frame for a joint torque [N m], and what will really act [N m]."""

    @abstractmethod
    def _fault(self, joint: int, now_s: float) -> str:
        """What the motor of `joint` says is wrong with it, or nothing."""

    def _doubt(self, joint: int) -> str:
        """What is odd about the motor of `joint`, or nothing: no fault, but a hint where there is one."""
        return ""

    @abstractmethod
    def _report(self) -> list[Finding]:
        """What the motors say of themselves, asked for if need be, with the torque off."""

    # What is common.

    def examine(self) -> tuple[Finding, ...]:
        findings = self._report()
        if count := self.line.counts["foreign id"]:
            value = f"{count} frames from ids that are not in the robot file: {self._foreign_listed}"
            findings.append(warn(self.line.label, value, self._foreign_remedy))
        if damaged := sum(self.line.counts[kind] for kind in ("error frame", "not valid", "damaged")):
            value = f"{damaged} error frames, damaged ones or such of a wrong length"
            remedy = "check bit rate, both terminators (120 ohm each) and ground"
            findings.append(fail(self.line.label, value, remedy))
        return tuple(findings)

    @property
    def _foreign_listed(self) -> str:
        """The ids of frames that are not for us, as they are written for CAN."""
        return ", ".join(f"0x{can_id:03X}" for can_id in sorted(self._foreign_ids))

    @property
    def _foreign_remedy(self) -> str:
        """What to do about such frames."""
        return "correct the ids, or take the others off"

    def _frame_s(self, byte_count: int, *, extended: bool = False) -> float:
        """Time that a frame is on the wire at least [s]; stuffing adds up to a fifth."""
        bits = _FRAME_BITS + _EXTENSION_BITS * extended + 8 * byte_count
        return bits / (self.line.bitrate or _USUAL_BITRATE)

    def close(self) -> None:
        self.line.close()

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`: takes what has arrived and does not wait.

        DeviceError: adapter failed or bus-off, or a motor reports an error; DeviceTimeoutError: a motor has
        fallen silent.
        """
        now_s = self._clock.now_s()
        self._drain(deadline_s)
        faults = [self._fault(joint, now_s) for joint in range(self.joint_count)]
        self._publish(faults)
        troubles = [
            fault or self._silence(joint, now_s) or self._doubt(joint) for joint, fault in enumerate(faults)
        ]
        problems = [
            f"{self.motor_label(joint)}: {trouble}" for joint, trouble in enumerate(troubles) if trouble
        ]
        if problems:
            kind = DeviceError if any(faults) else DeviceTimeoutError
            raise kind(f"{self.line.label}: {'; '.join(problems)}")

    def stage(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointBus.stage`."""
        if not self._powered:
            raise LifecycleError("the motors are off: activate them before the first command")
        pairs = [self._encode_torque(joint, torque) for joint, torque in enumerate(torque_nm.tolist())]
        self._staged = [frame for frame, _ in pairs]
        return np.array([sent for _, sent in pairs])

    def power_off(self) -> None:
        self._powered = False
        self._staged = []
        if self.line.is_open:
            self._switch_off()

    def flush(self, deadline_s: float) -> None:
        staged, self._staged = self._staged, []
        for frame in staged:
            self._send(frame, deadline_s)

    def _send(self, frame: CanFrame, deadline_s: float) -> None:
        self.line.send(frame, deadline_s)

    def _about(self, joint: int, problem: str) -> DeviceError:
        return DeviceError(f"{self.line.label}: {self.motor_label(joint)}: {problem}")

    def _drain(self, deadline_s: float) -> None:
        for frame, at_s in self.line.drain(deadline_s):
            try:
                if not self._take(frame, at_s):
                    self.line.counts["foreign id"] += 1
                    if len(self._foreign_ids) < _MOST_FOREIGN:
                        self._foreign_ids.add(frame.can_id)
            except ProtocolError as error:
                self.line.counts["not valid"] += 1
                joint = self._joint_of(frame)
                if joint is not None:
                    self._last_problem[joint] = str(error)

    def _silence(self, joint: int, now_s: float) -> str:
        """What has not come from the motor of `joint` for half of its age limit, or nothing."""
        limits, what, age_s = self._limits, "nothing valid", now_s - self._motion_at_s[joint]
        if age_s <= _SILENT_SHARE * limits.encoder_age_s:
            what, age_s = "no torques", now_s - self._torque_at_s[joint]
            if age_s <= _SILENT_SHARE * limits.torque_age_s:
                return ""
        since = "has not been heard yet" if age_s == inf else f"{what} for {age_s * 1e3:.1f} ms"
        last = self._last_problem[joint]
        return f"{since}; last was: {last}" if last else since

    def _publish(self, faults: Sequence[str]) -> None:
        motion_at_s, torque_at_s = min(self._motion_at_s), min(self._torque_at_s)
        motion = Status.SATURATED if any(self._at_range_end) else Status.OK
        motion = Status.FAULT if any(self._motion_is_wrong) else motion
        motion = Status.STALE if motion_at_s == -inf else motion
        self.position = Reading(np.array(self._position_rad), motion_at_s, motion)
        self.velocity = Reading(np.array(self._velocity_rad_s), motion_at_s, motion)
        torque = Status.FAULT if any(faults) else Status.OK
        torque = Status.STALE if torque_at_s == -inf else torque
        self.torque = Reading(np.array(self._torque_nm), torque_at_s, torque)

    def _send_all(self, frames: Sequence[CanFrame]) -> None:
        """Send every frame, whatever becomes of the others. DeviceError: some could not be sent."""
        failures: list[DeviceError] = []
        for frame in frames:
            try:
                self._send(frame, self._clock.now_s() + _LOOK_S)
            except DeviceError as error:
                failures.append(error)
        if failures:
            raise failures[0]

    def _wait_for(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Take in frames until `done`, or until the time is over; says which."""
        end_s = self._clock.now_s() + timeout_s
        while True:
            self._drain(end_s)
            if done():
                return True
            if self._clock.now_s() >= end_s:
                return False
            self._clock.sleep_until(self._clock.now_s() + _LOOK_S)
