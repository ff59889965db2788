"""Motors in MIT mode on a CAN bus: zero gains and feed-forward torque, orders, registers and answers."""

from collections.abc import Mapping
from contextlib import suppress
from math import inf

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.can.line import CanFrame
from palpate.robot_io.drivers.can.motors import ANSWER_S, ATTEMPTS, PolledMotorBus
from palpate.robot_io.drivers.joint_bus import joint_drivers
from palpate.robot_io.drivers.mit.protocol import (
    TIMEOUT_STEP_S,
    WARNING_BITS,
    MitRanges,
    MitState,
    MotorCommand,
    MotorRegister,
)
from palpate.robot_io.drivers.mit.settings import MitBusSettings
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError, ProtocolError
from palpate.robot_io.examination import Finding, fail, ok, warn
from palpate.robot_io.files.file_model import input_error

_SAME_RANGE = 1e-3  # relative tolerance between a motor's own range and the stated one
_SAME_POSITION_RAD = 0.02  # between two answers of a motor without torque
_TRIAL_SHARE = 0.01  # share of a motor's torque range
_TRIAL_S = 0.01  # time until the torque is exerted


class MitBus(PolledMotorBus[MitState]):
    """Bus of MIT-mode motors of any maker."""

    name = "mit_bus"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        validated = context.settings_as(MitBusSettings, settings)
        ids = [motor.motor_id for motor in validated.motors]
        super().__init__(validated, validated.motors, context, ids, validated.watchdog_s)
        self._settings = validated
        self._motors = validated.motors
        self._dialect = validated.dialect
        self._ranges = [
            MitRanges(own.position_rad, own.velocity_rad_s, own.torque_nm)
            if (own := motor.ranges) is not None
            else validated.dialect.models[motor.model]
            for motor in validated.motors
        ]
        # Beyond this angle of its shaft, a motor may pass the end of its range until its next state [rad].
        self._last_rad = [
            ranges.position_rad - motor.gear_ratio * fastest * self._limits.encoder_age_s
            for ranges, motor, fastest in zip(
                self._ranges, self._motors, self._limits.velocity_rad_s, strict=True
            )
        ]
        self._has_left_range = [False] * len(validated.motors)
        self._check_position_ranges(context)
        answer_ids = {motor.motor_id: validated.answer_ids(motor) for motor in validated.motors}
        self._frames = validated.dialect.frames(validated.host, answer_ids)
        # Errors and warnings that were reported without a request.
        self._alarms, self._warnings = [0] * len(validated.motors), [0] * len(validated.motors)
        self._register_asked: tuple[int, MotorRegister] | None = None  # joint and register
        self._register_values: list[float] = []
        if self._dialect.may_report:
            reports = "does the motor send reports without a request? To stop them, turn active reporting off"
            self._two_motors = f"do two motors have this id, or {reports}"
        if validated.ask_with == "exit" and not self._dialect.activation_registers:
            self._silence_remedy = "a motor that answers only in motor mode needs 'ask_with: enter'"

    def _check_position_ranges(self, context: DriverContext) -> None:
        """Raise `InputError` if a stop at a position limit could end beyond the range of a motor's positions.

        At the end of its range a motor repeats the last number, or continues at the other end.
        """
        limits, document = self._limits, context.robot_file.document
        stop_s = limits.encoder_age_s + context.robot_file.safe_state.stop_time_s
        for joint, (motor, ranges) in enumerate(zip(self._motors, self._ranges, strict=True)):
            half_rad, stop_rad = ranges.position_rad / motor.gear_ratio, limits.velocity_rad_s[joint] * stop_s
            for key, sign, most in (("position_min_rad", -1, "least"), ("position_max_rad", 1, "most")):
                limit_rad = getattr(limits, key)[joint]
                valid_rad = motor.zero_rad + sign * (half_rad - stop_rad)
                if sign * (limit_rad - valid_rad) > 0.0:
                    raise input_error(
                        document,
                        ("limits", key, joint),
                        f"{self.motor_label(joint)} reports {motor.zero_rad - half_rad:.2f} to "
                        f"{motor.zero_rad + half_rad:.2f} rad, and a stop needs up to {stop_rad:.2f} rad "
                        f"beyond this limit; set the limit to at {most} {valid_rad:.2f}, or lower "
                        "velocity_rad_s or safe_state.stop_time_s, or change the motor's zero_rad or "
                        "gear_ratio",
                        limit_rad,
                    )

    def _joint_of(self, frame: CanFrame) -> int | None:
        sender = self._frames.sender(frame)
        return None if sender is None else self._joint_by_id.get(sender)

    def _store_frame(self, joint: int, frame: CanFrame, at_s: float) -> bool:
        motor_id = self._motor_ids[joint]
        if self._frames.is_about_register(frame, motor_id):
            asked_joint, register = self._register_asked or (None, None)
            if register and asked_joint == joint:
                with suppress(ProtocolError):  # it is about another register
                    self._register_values.append(self._frames.register_value(frame, motor_id, register))
        elif (alarm := self._frames.alarm(frame)) is not None:
            self._alarms[joint], self._warnings[joint] = alarm & ~WARNING_BITS, alarm & WARNING_BITS
        else:
            self._states[joint].append((self._frames.state(frame, self._ranges[joint]), at_s))
        return True

    def _answering_motor(self, frame: CanFrame) -> int | None:
        return self._frames.answering_motor(frame)

    def _condition(self, state: MitState) -> tuple[int, bool | None]:
        return state.error, state.enabled

    def _store_state(self, joint: int, state: MitState, requested_s: float) -> None:
        self._store_motion(joint, state.position_rad, state.velocity_rad_s, requested_s)
        self._store_torque(joint, state.torque_nm, requested_s)
        self._has_left_range[joint] |= abs(state.position_rad) > self._last_rad[joint]
        self._torque_at_end[joint] = state.torque_at_end
        self._at_range_end[joint] = state.at_range_end or self._has_left_range[joint]
        fault, error = self._dialect.encoder_fault, state.error
        is_fault = error & fault if fault and self._dialect.errors_are_bits else error == fault
        self._motion_is_wrong[joint] = bool(is_fault)

    def _encode_shaft(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        return self._frames.torque(self._motor_ids[joint], torque_nm, self._ranges[joint])

    @property
    def _foreign_remedy(self) -> str:
        """See `MotorBus`; Damiao's motors are delivered with a master id of 0."""
        if not self._dialect.has_answer_ids:
            return super()._foreign_remedy
        ids = ", ".join(f"0x{self._settings.answer_ids(motor)[0]:03X}" for motor in self._motors)
        return f"set the master id of each motor ({ids} according to the robot file), or state its answer_id"

    def _hint(self, joint: int) -> str:
        """See `MotorBus._hint`; from the end of its range on, a motor's turn is unknown."""
        if not self._has_left_range[joint]:
            warnings = self._warnings[joint]
            return f"warns: {self._error_names(warnings)}" if warnings else ""
        end_rad = self._ranges[joint].position_rad
        return f"was at the end of its range of {end_rad:.2f} rad; turn the joint back, then start again"

    def _error_names(self, error: int) -> str:
        return self._dialect.error_names(error)

    def _error(self, joint: int) -> int:
        return self._errors[joint] | self._alarms[joint]

    def _refuse_errors(self, but: int | None = None) -> None:
        """See `PolledMotorBus._refuse_errors`; unsolicited errors are named once, then states count."""
        try:
            super()._refuse_errors(but)
        finally:
            self._alarms = [0] * self.joint_count

    def _command_frames(self, order: MotorCommand) -> list[CanFrame]:
        return [self._frames.order(motor_id, order) for motor_id in self._motor_ids]

    def _register(self, joint: int, register: MotorRegister, value: float | None = None) -> float:
        """Set a register if `value` is given, and return its value; raise `DeviceError` without an answer."""
        motor_id = self._motor_ids[joint]
        write = [] if value is None else [self._frames.write_register(motor_id, register, value)]
        self._register_asked = (joint, register)
        try:
            for _ in range(ATTEMPTS):  # either frame may be lost
                self._register_values = []
                self._send_all([*write, self._frames.read_register(motor_id, register)])
                is_read = self._wait_for(lambda: bool(self._register_values), ANSWER_S)
                if is_read and value in (None, self._register_values[0]):
                    break
        finally:
            self._register_asked = None
        if not self._register_values:
            raise self._motor_error(joint, f"does not report its {register.name}")
        return self._register_values[0]

    def configure(self) -> None:
        """Read a state of every motor, torque off; raise `DeviceError` if one is silent or differs."""
        self._receive_all()
        # Compare the ranges of the numbers on the wire with the robot file.
        for joint, ranges in enumerate(self._ranges):
            all_stated = (ranges.position_rad, ranges.velocity_rad_s, ranges.torque_nm)
            for register, stated in zip(self._dialect.range_registers, all_stated, strict=False):
                reported = self._register(joint, register)
                if not abs(reported - stated) <= _SAME_RANGE * stated:
                    problem = f"its {register.name} is {reported:g}, but the robot file states {stated:g}"
                    raise self._motor_error(
                        joint, f"{problem}: correct 'ranges' in the robot file, or the motor's setting"
                    )
            if self._dialect.position_register:
                # Its position must agree with its states, on the same turn.
                register = self._dialect.position_register
                shaft_rad = self._register(joint, register)
                reported_rad = self._motors[joint].zero_rad + shaft_rad / self._ratios[joint]
                before_rad = self._position_rad[joint]
                self._ask_again()
                stated_rad = self._position_rad[joint]
                low_rad, high_rad = sorted((before_rad, stated_rad))  # a hand may move the arm meanwhile
                if not low_rad - _SAME_POSITION_RAD <= reported_rad <= high_rad + _SAME_POSITION_RAD:
                    problem = (
                        f"its {register.name} is {reported_rad:.3f} rad at the joint, but its messages report"
                    )
                    remedy = (
                        "turn the joint back into the range of these messages, or correct the motor's "
                        "'ranges' in the robot file"
                    )
                    if high_rad - low_rad > _SAME_POSITION_RAD:
                        remedy = "the joint moves, so hold the arm still, and start again"
                    raise self._motor_error(joint, f"{problem} {stated_rad:.3f}: {remedy}")

    def _ask_again(self) -> None:
        """Wait for a new state of every motor without torque."""
        self._motion_at_s = [-inf] * self.joint_count
        self._request_states(range(self.joint_count))
        self._wait_for(lambda: -inf not in self._motion_at_s, ANSWER_S)

    def _report(self) -> list[Finding]:
        """See `MotorBus._report`; the protocol reports neither voltage nor firmware."""
        self._ask_again()
        evidence = "set and read back" if self._dialect.activation_registers else ""
        if self._tests_watchdogs:
            evidence = "set, read back and tested" if self._dialect.activation_registers else "tested"
        findings = []
        for joint, motor in enumerate(self._motors):
            label, error = self.motor_label(joint), self._error(joint)
            if self._motion_at_s[joint] == -inf:
                remedy = "check its power, cable and id, and its protocol"
                remedy += f"; {self._silence_remedy}" if self._silence_remedy else ""
                findings.append(fail(label, "does not answer", remedy))
            elif error:
                remedy = "remove the cause, then restart it"
                findings.append(fail(label, self._error_names(error), remedy))
            else:
                value = f"answers, at {self._position_rad[joint]:+.3f} rad; does not report its model; "
                value += f"the robot file states {motor.model}; CAN timeout {self._settings.watchdog_s:g} s, "
                value += f"{evidence} at activation"
                if warnings := self._warnings[joint]:
                    value = f"warns: {self._error_names(warnings)}; {value}"
                    findings.append(warn(label, value, "let the motor cool down, or lower its load"))
                else:
                    findings.append(ok(label, value))
        return findings

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`: a command to each motor, and its answer."""
        return 2 * self.joint_count * self._frame_s(8, extended=self._frames.extended)

    @property
    def _tests_watchdogs(self) -> bool:
        """Whether each activation lets the CAN timeouts expire; not if the timeout is an error."""
        return self._dialect.timeout_error is None

    def power_on(self) -> None:
        if self._dialect.activation_registers:
            self._set_up()
        frames = [*self._command_frames(MotorCommand.ENTER), *self._zero_torque()]
        self._send_confirmed(frames, "motor mode is not confirmed by", enabled=True)
        self._check_unique_ids()
        self._refuse_errors()
        if self._tests_watchdogs:
            self._check_watchdogs()
            self._send_confirmed(frames, "motor mode is not confirmed by", enabled=True)
        self._begin_commands()

    def _set_up(self) -> None:
        """Set mode and CAN timeout, clear an expired timeout; raise `DeviceError` if one is rejected."""
        dialect = self._dialect
        timeout = round(self._settings.watchdog_s / TIMEOUT_STEP_S)
        for joint in range(self.joint_count):
            for register, value in dialect.activation_registers:
                setting = timeout if value is None else value
                reported = self._register(joint, register, setting)
                if reported != setting:
                    raise self._motor_error(
                        joint, f"its {register.name} is {reported:g} after it was set to {setting}"
                    )
        self._switch_off()
        self._refuse_errors(but=dialect.timeout_error)
        self._send_all(
            [
                self._frames.order(motor_id, MotorCommand.CLEAR)
                for motor_id, error in zip(self._motor_ids, self._errors, strict=True)
                if error and error == dialect.timeout_error
            ]
        )

    def _check_watchdogs(self) -> None:
        """Let all watchdogs expire; raise `DeviceError` if a motor keeps its torque, or never shows any."""
        # A motor that reports its mode must have left motor mode. Any other motor exerts a small torque
        # before the silence, and is asked afterwards by the frame that enters motor mode.
        if self._dialect.activation_registers:
            self._wait_for_watchdogs()
            self._exchange(self._zero_torque())
            self._refuse_active(map(bool, self._enabled), "is still in motor mode")
            return
        trial_nm = [
            _TRIAL_SHARE * ranges.torque_nm * abs(motor.signed_ratio)
            for ranges, motor in zip(self._ranges, self._motors, strict=True)
        ]
        trial = [self._encode_torque(joint, torque_nm)[0] for joint, torque_nm in enumerate(trial_nm)]
        for attempts_left in reversed(range(ATTEMPTS)):
            self._exchange(trial)
            self._wait_for(lambda: False, _TRIAL_S)
            exerting = self._exert_torque(trial, trial_nm)
            if not all(exerting):
                idle = self.motor_label(exerting.index(False))
                raise DeviceError(f"{self.line.label}: {idle} reports no torque although one was commanded")
            self._wait_for_watchdogs()
            try:  # this frame ends a torque, so after a lost answer the whole test is repeated
                enter = self._command_frames(MotorCommand.ENTER)
                self._refuse_active(self._exert_torque(enter, trial_nm, attempts=1), "still exerts torque")
            except DeviceTimeoutError:
                if not attempts_left:
                    raise
            else:
                return

    def _exert_torque(
        self, frames: list[CanFrame], trial_nm: list[float], attempts: int = ATTEMPTS
    ) -> list[bool]:
        """Whether the answers to `frames`, one to each motor, show at least half of torques (n) [N m]."""
        self._exchange(frames, attempts)
        return [torque >= 0.5 * trial for torque, trial in zip(self._torque_nm, trial_nm, strict=True)]

    def _switch_off(self) -> None:
        """See `MotorBus._switch_off`; each motor must answer, even if it is off and ignores commands."""
        leave = self._command_frames(MotorCommand.LEAVE)
        frames = [*self._zero_torque(), *leave, *leave]
        self._send_confirmed(frames, "torque off is not confirmed by", enabled=False)

    def _state_requests(self, joint: int) -> list[CanFrame]:
        motor_id = self._motor_ids[joint]
        leave = self._frames.order(motor_id, MotorCommand.LEAVE)
        if self._settings.ask_with == "exit":
            return [leave]
        # A motor asked in this way has power, at zero torque, until the frame after the next arrives.
        return [self._frames.order(motor_id, MotorCommand.ENTER), self._encode_torque(joint, 0.0)[0], leave]


MitEncoder, MitTorque = joint_drivers(MitBus, "mit")
