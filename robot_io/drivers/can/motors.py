"""Joints driven by motors on a CAN bus, including motors that send only on request.

A motor that sends only on request answers each command with its state, which the next poll reads. While the
torque is off, each poll sends a request. Answers carry neither time nor number, so each belongs to the oldest
open request of its motor, and gets the time of that request.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from math import inf
from typing import Annotated, Generic, TypeVar

import numpy as np
from pydantic import StrictBool

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.can.line import CanFrame, CanLine, CanLineSettings
from palpate.robot_io.drivers.joint_bus import JointBus, RequestQueue, check_one_per_joint
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError, LifecycleError, ProtocolError
from palpate.robot_io.examination import Examinable, Finding, fail, warn
from palpate.robot_io.files.file_model import FileModel, Number, ZeroAngle, between
from palpate.robot_io.types import FloatArray, Reading, Status

# Share of the age limit from which silence is reported, so that the cause is known at the limit.
_SILENT_SHARE = 0.5
_FRAME_BITS = 47  # bits of a frame with an 11 bit id and the gap after it, without its data (ISO 11898-1)
_EXTENSION_BITS = 20  # additional bits with a 29 bit id
_USUAL_BITRATE = 1_000_000  # assumed if the robot file leaves the bit rate to the adapter [bit/s]
_POLL_PERIOD_S = 1e-3  # while waiting for an answer
_MOST_FOREIGN = 20  # largest number of foreign ids that are listed


class MotorMounting(FileModel):
    """Mounting of a motor: joint angle = zero_rad + sign * shaft angle / gear_ratio."""

    # Turns reported by the drive for one turn of the joint.
    gear_ratio: Annotated[Number, between(1e-3, 1e4, "turns")] = 1.0
    reversed: StrictBool = False  # whether a positive shaft angle turns the joint backwards
    zero_rad: ZeroAngle = 0.0  # joint angle at the zero of the drive [rad]

    @property
    def signed_ratio(self) -> float:
        """Shaft turns for one turn of the joint, negative if reversed."""
        return -self.gear_ratio if self.reversed else self.gear_ratio


class MotorBus(JointBus, Examinable):
    """Motors on one CAN bus, one per joint from base to tip.

    A protocol says how a frame changes a joint (`_store_frame`), how a torque is sent, and how motors are
    powered.
    """

    def __init__(
        self, line: CanLineSettings, mountings: Sequence[MotorMounting], context: DriverContext
    ) -> None:
        check_one_per_joint(context, len(mountings), "motors")
        self._clock = context.clock
        self._mountings = tuple(mountings)
        self._ratios = [mounting.signed_ratio for mounting in mountings]  # computed once: used in each tick
        self._limits = context.robot_file.limits
        self.line = CanLine(line, context.clock)
        n = len(mountings)
        self._position_rad, self._velocity_rad_s, self._torque_nm = ([float("nan")] * n for _ in range(3))
        self._motion_at_s, self._torque_at_s = [-inf] * n, [-inf] * n
        self._at_range_end, self._torque_at_end = [False] * n, [False] * n
        self._motion_is_wrong = [False] * n  # the motor reports that its encoder has failed
        # What showed that a motor has restarted or switched itself off, until the torque is switched off.
        self._lost = [""] * n
        self._last_problem = [""] * n
        self._foreign_ids: set[int] = set()
        self._staged: list[CanFrame] = []
        self._powered = False
        self._publish([""] * n)

    @property
    def joint_count(self) -> int:
        return len(self._mountings)

    # Implemented by each protocol.

    @abstractmethod
    def motor_label(self, joint: int) -> str:
        """Return the name of a joint's motor in messages.

        Args:
            joint: index of the joint, from 0.
        """

    @abstractmethod
    def _switch_off(self) -> None:
        """Switch off the torque of all motors on an open line; raise `DeviceError` if one did not confirm."""

    @abstractmethod
    def _joint_of(self, frame: CanFrame) -> int | None:
        """Return which joint a frame comes from; None if it is from another sender."""

    @abstractmethod
    def _store_frame(self, joint: int, frame: CanFrame, at_s: float) -> bool:
        """Store a frame's state; return False if it is unknown, raise `ProtocolError` if it is invalid."""

    @abstractmethod
    def _encode_shaft(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        """Return the frame for a torque of the motor's shaft [N m], and the torque that will act there."""

    @abstractmethod
    def _fault(self, joint: int, now_s: float) -> str:
        """Return the error that a joint's motor reports, or an empty string."""

    def _hint(self, joint: int) -> str:
        """Return a hint about the motor of `joint`, if any; it is not a fault."""
        return ""

    @abstractmethod
    def _report(self) -> list[Finding]:
        """Read the identity and state of the motors, by request if needed, with the torque off."""

    # Common to all protocols.

    def _encode_torque(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        """Return the frame for a joint torque [N m], and the joint torque that will act."""
        ratio = self._ratios[joint]
        frame, shaft_nm = self._encode_shaft(joint, torque_nm / ratio)
        return frame, shaft_nm * ratio

    def _store_motion(self, joint: int, shaft_rad: float, shaft_rad_s: float, at_s: float) -> None:
        """Store angle and speed of a motor's shaft at a time as those of its joint."""
        ratio = self._ratios[joint]
        self._position_rad[joint] = self._mountings[joint].zero_rad + shaft_rad / ratio
        self._velocity_rad_s[joint] = shaft_rad_s / ratio
        self._motion_at_s[joint] = at_s

    def _store_torque(self, joint: int, shaft_nm: float, at_s: float) -> None:
        """Store the torque of a motor's shaft at a time as that of its joint."""
        self._torque_nm[joint] = shaft_nm * self._ratios[joint]
        self._torque_at_s[joint] = at_s

    def examine(self) -> tuple[Finding, ...]:
        findings = self._report()
        if count := self.line.counts["foreign id"]:
            value = f"{count} frames from ids that are not in the robot file: {self._list_foreign_ids}"
            findings.append(warn(self.line.label, value, self._foreign_remedy))
        if damaged := sum(self.line.counts[kind] for kind in ("error frame", "not valid", "damaged")):
            value = f"{damaged} error frames, damaged frames or frames of a wrong length"
            remedy = "check bit rate, both terminators (120 ohm each) and ground"
            findings.append(fail(self.line.label, value, remedy))
        return tuple(findings)

    @property
    def _list_foreign_ids(self) -> str:
        """Return the ids of foreign frames, in the usual CAN notation."""
        return ", ".join(f"0x{can_id:03X}" for can_id in sorted(self._foreign_ids))

    @property
    def _foreign_remedy(self) -> str:
        """Return a remedy for foreign frames."""
        return "correct the ids, or remove the other devices"

    def _frame_s(self, byte_count: int, *, extended: bool = False) -> float:
        """Return the least time of a frame on the wire [s]; bit stuffing adds up to a fifth."""
        bits = _FRAME_BITS + _EXTENSION_BITS * extended + 8 * byte_count
        return bits / (self.line.bitrate or _USUAL_BITRATE)

    def close(self) -> None:
        self.line.close()

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`: takes what has arrived and does not wait.

        Raises:
            DeviceError: adapter failed or bus-off, or a motor reports an error.
            DeviceTimeoutError: a motor has stopped answering.
        """
        now_s = self._clock.now_s()
        self._drain(deadline_s)
        faults = [self._fault(joint, now_s) for joint in range(self.joint_count)]
        self._publish(faults)
        problems = [
            f"{self.motor_label(joint)}: {problem}"
            for joint, fault in enumerate(faults)
            if (problem := fault or self._silence_problem(joint, now_s) or self._hint(joint))
        ]
        if problems:
            kind = DeviceError if any(faults) else DeviceTimeoutError
            raise kind(f"{self.line.label}: {'; '.join(problems)}")

    def stage(self, torque_nm: FloatArray) -> FloatArray:
        if not self._powered:
            raise LifecycleError("the motors are off; activate them before the first command")
        pairs = [self._encode_torque(joint, torque) for joint, torque in enumerate(torque_nm.tolist())]
        self._staged = [frame for frame, _ in pairs]
        return np.array([sent for _, sent in pairs])

    def power_off(self) -> None:
        self._powered = False
        self._staged, self._lost = [], [""] * self.joint_count
        if self.line.is_open:
            self._switch_off()

    def flush(self, deadline_s: float) -> None:
        staged, self._staged = self._staged, []
        for frame in staged:
            self._send(frame, deadline_s)

    def _send(self, frame: CanFrame, deadline_s: float) -> None:
        self.line.send(frame, deadline_s)

    def _motor_error(self, joint: int, problem: str) -> DeviceError:
        return DeviceError(f"{self.line.label}: {self.motor_label(joint)}: {problem}")

    def _drain(self, deadline_s: float) -> None:
        for frame, at_s in self.line.drain(deadline_s):
            if (joint := self._joint_of(frame)) is not None:
                try:
                    if self._store_frame(joint, frame, at_s):
                        continue
                except ProtocolError as error:
                    self.line.counts["not valid"] += 1
                    self._last_problem[joint] = str(error)
                    continue
            self.line.counts["foreign id"] += 1
            if len(self._foreign_ids) < _MOST_FOREIGN:
                self._foreign_ids.add(frame.can_id)

    def _silence_problem(self, joint: int, now_s: float) -> str:
        """Return which data of `joint` are missing for half of the age limit, or an empty string."""
        limits, missing, age_s = self._limits, "nothing valid", now_s - self._motion_at_s[joint]
        if age_s <= _SILENT_SHARE * limits.encoder_age_s:
            missing, age_s = "no torques", now_s - self._torque_at_s[joint]
            if age_s <= _SILENT_SHARE * limits.torque_age_s:
                return ""
        since = "has sent nothing yet" if age_s == inf else f"{missing} for {age_s * 1e3:.1f} ms"
        last = self._last_problem[joint]
        return f"{since}; last problem: {last}" if last else since

    def _publish(self, faults: Sequence[str]) -> None:
        motion_at_s, torque_at_s = min(self._motion_at_s), min(self._torque_at_s)
        motion_status = Status.SATURATED if any(self._at_range_end) else Status.OK
        motion_status = Status.FAULT if any(self._motion_is_wrong) else motion_status
        motion_status = Status.STALE if motion_at_s == -inf else motion_status
        self.position = Reading(np.array(self._position_rad), motion_at_s, motion_status)
        self.velocity = Reading(np.array(self._velocity_rad_s), motion_at_s, motion_status)
        torque_status = Status.SATURATED if any(self._torque_at_end) else Status.OK
        torque_status = Status.FAULT if any(faults) else torque_status
        torque_status = Status.STALE if torque_at_s == -inf else torque_status
        saturated = tuple(self._torque_at_end)
        self.torque = Reading(np.array(self._torque_nm), torque_at_s, torque_status, saturated)

    def _send_all(self, frames: Sequence[CanFrame]) -> None:
        """Send every frame, even after a failure; raise `DeviceError` if some could not be sent."""
        failures: list[DeviceError] = []
        for frame in frames:
            try:
                self._send(frame, self._clock.now_s() + _POLL_PERIOD_S)
            except DeviceError as error:
                failures.append(error)
        if failures:
            raise failures[0]

    def _wait_for(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Receive frames until `done` or until the time-out; return whether `done`."""
        end_s = self._clock.now_s() + timeout_s
        while True:
            self._drain(end_s)
            if done():
                return True
            if self._clock.now_s() >= end_s:
                return False
            self._clock.sleep_until(self._clock.now_s() + _POLL_PERIOD_S)


ANSWER_S = 0.05  # longest wait for an answer; longer than any motor needs
ATTEMPTS = 3  # requests to each motor, except in a run, since a frame may be lost or late
_SECOND_ANSWER_S = 2e-3  # after this time, a second motor with the same id has answered too
_LATEST_WATCHDOG = 1.5  # multiple of the watchdog's time by which it has fired
_MARGIN_SHARE = 0.5  # variation of delays, as a share of a tick
_CONTRADICTIONS = 3  # consecutive polls with several states for one request that show two motors

StateType = TypeVar("StateType")


class PolledMotorBus(MotorBus, Generic[StateType]):
    """Motors that answer each frame with their state, and switch off `watchdog_s` after the last command."""

    _two_motors = "do two motors have this id?"  # asked after more answers than requests
    _silence_remedy = ""  # what may make silent motors answer, if anything special does

    def __init__(
        self,
        line: CanLineSettings,
        mountings: Sequence[MotorMounting],
        context: DriverContext,
        motor_ids: Sequence[int],
        watchdog_s: float,
    ) -> None:
        super().__init__(line, mountings, context)
        self._motor_ids, self._watchdog_s = tuple(motor_ids), watchdog_s
        self._joint_by_id = {motor_id: joint for joint, motor_id in enumerate(motor_ids)}
        self._errors = [0] * len(mountings)
        self._enabled: list[bool | None] = [None] * len(mountings)
        margin_s = _MARGIN_SHARE / context.robot_file.control_rate_hz
        self._requests = [RequestQueue(margin_s, ANSWER_S) for _ in mountings]
        # States since the last poll.
        self._states: list[list[tuple[StateType, float]]] = [[] for _ in mountings]
        # Newest states without a known request.
        self._newest: list[StateType | None] = [None] * len(mountings)
        self._answers, self._unrequested = [0] * len(mountings), [0] * len(mountings)
        self._contradictions = [0] * len(mountings)
        self._commanded_s = -inf
        self._command: list[CanFrame] = []
        self._flushed = False

    # Implemented by each protocol.

    @abstractmethod
    def _state_requests(self, joint: int) -> list[CanFrame]:
        """Return the frames that request the state of a motor without torque."""

    @abstractmethod
    def _answering_motor(self, frame: CanFrame) -> int | None:
        """Return the motor that answers a frame with its state, by its id; None if none does."""

    @abstractmethod
    def _condition(self, state: StateType) -> tuple[int, bool | None]:
        """Return the error of a motor (0 for none), and whether it is in motor mode (None if unknown)."""

    @abstractmethod
    def _store_state(self, joint: int, state: StateType, requested_s: float) -> None:
        """Store the motion that a motor reports for its joint and that was requested at `requested_s` [s]."""

    @abstractmethod
    def _error_names(self, error: int) -> str:
        """Return the names of an error."""

    def _error(self, joint: int) -> int:
        """Return the error of a motor; 0 for none."""
        return self._errors[joint]

    # Common to all protocols.

    def motor_label(self, joint: int) -> str:
        return f"joint {joint + 1} (motor {self._motor_ids[joint]})"

    def _receive_all(self) -> None:
        """Open the adapter, receive a state of every motor with an id of its own, or raise `DeviceError`."""
        self.line.open()
        for _ in range(ATTEMPTS):
            self._unrequested = [0] * self.joint_count
            self._request_states(range(self.joint_count))
            self._wait_for(lambda: -inf not in self._motion_at_s or any(self._unrequested), ANSWER_S)
            self._wait_for(lambda: False, _SECOND_ANSWER_S)
            silent = [joint for joint, at_s in enumerate(self._motion_at_s) if at_s == -inf]
            if not silent and not any(self._unrequested):
                return
            self._wait_for(lambda: False, ANSWER_S)  # a late answer looks like that of a second motor
        self._refuse_duplicate_ids()
        refused = [f" ({problem})" if (problem := self._last_problem[joint]) else "" for joint in silent]
        names = [self.motor_label(joint) + why for joint, why in zip(silent, refused, strict=True)]
        problem = f"no {'valid ' * any(refused)}answer in {ANSWER_S} s from {', '.join(names)}"
        if self._foreign_ids:
            problem += f"; received frames with the ids {self._list_foreign_ids}: {self._foreign_remedy}"
        elif self._silence_remedy and not any(refused):
            problem += f"; {self._silence_remedy}"
        raise DeviceError(f"{self.line.label}: {problem}")

    def _request_states(self, joints: Iterable[int]) -> None:
        """Request the states of motors whose torque is off."""
        self._send_all([frame for joint in joints for frame in self._state_requests(joint)])

    def _refuse_duplicate_ids(self) -> None:
        """Raise a DeviceError if a motor answers more often than it was asked."""
        if duplicates := self._duplicate_ids():
            raise DeviceError(f"{self.line.label}: {duplicates}")

    def _check_unique_ids(self) -> None:
        """Exchange zero torques until one exchange is clean; raise `DeviceError` if none is."""
        for _ in range(ATTEMPTS):
            if any(self._unrequested):
                self._unrequested = [0] * self.joint_count
                self._exchange(self._zero_torque())
                self._wait_for(lambda: False, _SECOND_ANSWER_S)
        self._refuse_duplicate_ids()

    def _duplicate_ids(self) -> str:
        """Name the motors that have answered more often than they were asked; empty if there are none."""
        return "; ".join(
            f"{self.motor_label(joint)}: answers more often than it is asked: {self._two_motors}"
            for joint, count in enumerate(self._unrequested)
            if count
        )

    def poll(self, deadline_s: float) -> None:
        """See `MotorBus.poll`; without a command since the last poll, sends requests for the next poll."""
        try:
            super().poll(deadline_s)
        finally:
            if not self.line.bus_off:
                # The motors answer the last command, which is repeated for at most the watchdog's time.
                if not self._powered:
                    self._request_states(self._joints_to_poll())
                elif not self._flushed:
                    is_expired = self._clock.now_s() - self._commanded_s > self._watchdog_s
                    self._send_all(
                        [
                            self._zero_torque()[joint]
                            if is_expired or self._lost[joint]
                            else self._command[joint]
                            for joint in self._joints_to_poll()
                        ]
                    )
            self._flushed = False

    def flush(self, deadline_s: float) -> None:
        if self._staged:
            self._commanded_s, self._command, self._flushed = self._clock.now_s(), self._staged, True
            self._staged = [self._staged[joint] for joint in self._joints_to_poll()]
        super().flush(deadline_s)

    def _joints_to_poll(self) -> list[int]:
        """Return the joints to ask, without those left out; see `RequestQueue.omit_next`."""
        return [joint for joint, requests in enumerate(self._requests) if not requests.omit_next()]

    def _send(self, frame: CanFrame, deadline_s: float) -> None:
        motor_id, sent_s = self._answering_motor(frame), self._clock.now_s()
        super()._send(frame, deadline_s)
        if motor_id is not None:  # a frame that the adapter refused gets no answer
            self._requests[self._joint_by_id[motor_id]].ask(sent_s)

    def _drain(self, deadline_s: float) -> None:
        super()._drain(deadline_s)
        for joint, requests in enumerate(self._requests):
            # More states than requests are late, or come from several motors with one id. If they differ, no
            # state is used; if they are equal, the newest requested state is.
            states, self._states[joint] = self._states[joint], []
            requested = [state for state, at_s in states if requests.answer(at_s)]
            self._answers[joint] += len(requested)
            self._unrequested[joint] += len(states) - len(requested)
            if len(requested) < len(states) and any(state != states[0][0] for state, _ in states):
                self._newest[joint] = None
                self._last_problem[joint] = f"more answers than requests: {self._two_motors}"
                self._contradictions[joint] += 1
                self._motion_is_wrong[joint] |= self._contradictions[joint] >= _CONTRADICTIONS
            elif requested:
                self._contradictions[joint], self._last_problem[joint] = 0, ""
                self._newest[joint] = requested[-1]
                self._errors[joint], self._enabled[joint] = self._condition(requested[-1])
                if self._powered and not self._lost[joint]:
                    self._lost[joint] = next(filter(None, map(self._loss, requested)), "")
            state = self._newest[joint]
            if state is not None and not requests.is_unsure:
                self._newest[joint] = None
                self._store_state(joint, state, requests.answered_s)

    def _fault(self, joint: int, now_s: float) -> str:
        if self._contradictions[joint] >= _CONTRADICTIONS:
            return f"answers more often than it is asked, with different states: {self._two_motors}"
        error = self._error(joint)
        return self._lost[joint] or (self._error_names(error) if error else "")

    def _loss(self, state: StateType) -> str:
        """Return what in a state shows that a motor with torque has left motor mode; empty if it has not."""
        error, is_enabled = self._condition(state)
        if is_enabled is not False:
            return ""
        return self._error_names(error) if error else "has left motor mode; has it restarted?"

    def _encode_torque(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        """See `MotorBus._encode_torque`; a lost motor is asked: a torque could switch it on again."""
        if self._lost[joint]:
            return self._state_requests(joint)[0], 0.0
        return super()._encode_torque(joint, torque_nm)

    def _begin_commands(self) -> None:
        """Expect commands from now on, starting with zero torque; the motors obey them."""
        self._powered = True
        self._command, self._commanded_s = self._zero_torque(), self._clock.now_s()

    def _zero_torque(self) -> list[CanFrame]:
        return [self._encode_torque(joint, 0.0)[0] for joint in range(self.joint_count)]

    def _send_confirmed(self, frames: list[CanFrame], problem: str, *, enabled: bool) -> None:
        """Send frames, two or more to each motor, and wait for two answers of each; raise `DeviceError`."""

        # A motor that reports its mode must report `enabled`, or an error.
        def missing() -> list[str]:
            return [
                self.motor_label(joint)
                for joint, (answers, is_on) in enumerate(zip(self._answers, self._enabled, strict=True))
                if answers < 2 or (not self._error(joint) and is_on not in (None, enabled))
            ]

        def have_answered(count: int) -> Callable[[], bool]:
            return lambda: min(self._answers) >= count

        # Later attempts wait after one frame to each motor: if answers come doubled, only equal ones count.
        count = self.joint_count
        single = [frames[start : start + count] for start in range(0, len(frames), count)]
        for batches in ([frames], *[single] * (ATTEMPTS - 1)):
            self._answers, self._unrequested = [0] * count, [0] * count
            for sent, batch in enumerate(batches[:-1], 1):
                self._send_all(batch)
                self._wait_for(have_answered(sent), ANSWER_S)
            self._send_all(batches[-1])
            if self._wait_for(lambda: not missing(), ANSWER_S):
                return
            self._forget_requests()
        raise self._not_confirmed(problem, missing())

    def _forget_requests(self) -> None:
        for requests in self._requests:
            requests.forget()

    def _not_confirmed(self, problem: str, motors: Iterable[str]) -> DeviceError:
        """Make the error for motors that did not confirm, with those whose ids are not unique."""
        duplicates = f"; {self._duplicate_ids()}" if any(self._unrequested) else ""
        return DeviceError(f"{self.line.label}: {problem} {', '.join(motors)}{duplicates}")

    def _exchange(self, frames: list[CanFrame], attempts: int = ATTEMPTS) -> None:
        """Send one frame to each motor until all answer; raise `DeviceTimeoutError` if a motor is silent."""
        self._answers = [0] * self.joint_count

        def silent() -> list[int]:  # with those whose answer is not attributed, and so not stored
            unsure = [requests.is_unsure for requests in self._requests]
            return [joint for joint, count in enumerate(self._answers) if not count or unsure[joint]]

        asked = list(range(self.joint_count))
        for _ in range(attempts):
            self._send_all([frames[joint] for joint in asked])
            if self._wait_for(lambda: not silent(), ANSWER_S):
                return
            asked = silent()
            self._forget_requests()
        label = self.motor_label(asked[0])
        raise DeviceTimeoutError(f"{self.line.label}: no answer in {ANSWER_S} s from {label}")

    def _refuse_errors(self, but: int | None = None) -> None:
        """Raise a DeviceError with the names of all motors that have an error other than `but`."""
        problems = [
            f"{self.motor_label(joint)}: {self._error_names(error)}"
            for joint in range(self.joint_count)
            if (error := self._error(joint)) not in (0, but)
        ]
        if problems:
            raise DeviceError(
                f"{self.line.label}: {'; '.join(problems)}; remove the cause, then restart the motor"
            )

    def _wait_for_watchdogs(self) -> None:
        """Send nothing for longer than the motors' watchdog time; then no earlier answers are left."""
        self._wait_for(lambda: False, _LATEST_WATCHDOG * self._watchdog_s)

    def _refuse_active(self, is_active: Iterable[bool], evidence: str) -> None:
        """Raise a DeviceError if some motors did not stop during the silence."""
        labels = [self.motor_label(joint) for joint, active in enumerate(is_active) if active]
        if labels:
            silence_s, limit_s = _LATEST_WATCHDOG * self._watchdog_s, self._watchdog_s
            raise DeviceError(
                f"{self.line.label}: {', '.join(labels)} {evidence} after {silence_s:.2g} s without "
                f"commands; set its timeout to {limit_s:g} s"
            )
