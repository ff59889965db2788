"""Motors in MIT mode (CubeMars AK, Damiao and kin) on a CAN bus: zero gains and feed-forward torque.

A motor speaks only when it is spoken to: each command is answered with the motor's state, which the next poll
takes in. While the torque is off, each poll asks again.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import inf

from robot_io.driver import DriverContext
from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.can.motors import MotorBus, MotorEncoder, MotorTorque
from robot_io.drivers.mit import protocol as mit
from robot_io.drivers.mit import registers
from robot_io.drivers.mit.makers import error_name
from robot_io.drivers.mit.registers import MotorRegister
from robot_io.drivers.mit.settings import MitBusSettings
from robot_io.errors import DeviceError, ProtocolError
from robot_io.examination import Finding, fail, ok

_ANSWER_S = 0.05  # more than any motor takes
_SAME_RANGE = 1e-3  # share by which a motor's own range may differ from the stated one
_TRIAL_SHARE = 0.01  # of a motor's torque range
_TRIAL_S = 0.01  # until it is exerted
_LATEST_WATCHDOG = 1.5  # times its time: it has fired by then


class MitBus(MotorBus):
    """MIT-mode motors on a CAN bus."""

    name = "mit_bus"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        own = context.settings_as(MitBusSettings, settings)
        super().__init__(own, own.motors, context)
        self._own = own
        self._motors = own.motors
        self._dialect = own.dialect
        self._ranges = [own.wire_ranges(motor) for motor in own.motors]
        self._answer_ids = [own.answer_ids(motor) for motor in own.motors]
        self._joint_by_id = {motor.motor_id: joint for joint, motor in enumerate(own.motors)}
        self._errors = [0] * len(own.motors)
        self._enabled: list[bool | None] = [None] * len(own.motors)
        self._register_asked: tuple[int, MotorRegister] | None = None  # and its joint, while awaited
        self._register_values: list[float] = []
        self._answers = [0] * len(own.motors)
        self._commanded_s = -inf
        self._command: list[CanFrame] = []
        self._flushed = False

    def motor_label(self, joint: int) -> str:
        return f"joint {joint + 1} (motor {self._motors[joint].motor_id})"

    def configure(self) -> None:
        """Open the adapter and hear every motor, with the torque off.

        DeviceError: the adapter cannot be opened, or a motor is silent.
        """
        self.line.open()
        self._ask()
        if not self._wait_for(lambda: -inf not in self._motion_at_s, _ANSWER_S):
            silent = [joint for joint, at_s in enumerate(self._motion_at_s) if at_s == -inf]
            labels = ", ".join(map(self.motor_label, silent))
            raise DeviceError(f"{self.line.label}: no answer in {_ANSWER_S} s from {labels}")
        if self._own.ask_with == "exit":  # one answer to each frame
            self._measure_latency(self._ask, self._motion_at_s)
        if self._dialect.has_registers:
            self._check_ranges()

    def _report(self) -> list[Finding]:
        """See `MotorBus._report`; the protocol tells neither voltage nor firmware."""
        self._motion_at_s = [-inf] * self.joint_count
        self._ask()
        self._wait_for(lambda: -inf not in self._motion_at_s, _ANSWER_S)
        observations = []
        for joint, motor in enumerate(self._motors):
            label, error = self.motor_label(joint), self._errors[joint]
            if self._motion_at_s[joint] == -inf:
                remedy = "check its power, cable and id, and that it is in MIT mode"
                observations.append(fail(label, "does not answer", remedy))
            elif error:
                observations.append(
                    fail(label, error_name(self._own.maker, error), "remove the cause, then restart it")
                )
            else:
                value = f"answers, at {self._position_rad[joint]:+.3f} rad; does not report its model, "
                value += f"the robot file says {motor.model}; CAN timeout {self._own.watchdog_s:g} s, "
                observations.append(ok(label, value + f"{self._timeout_evidence} at activation"))
        return observations

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`: a command to each motor, and its answer."""
        return 2 * self.joint_count * self._frame_s(8)

    @property
    def _timeout_evidence(self) -> str:
        """How the CAN timeout is known."""
        return "set and read back" if self._dialect.has_registers else "proven"

    def power_on(self) -> None:
        if self._dialect.has_registers:
            self._set_up()
        frames = [*self._to_every_motor(mit.ENTER_MOTOR_MODE), *self._zero_torque()]
        self._send_confirmed(frames, "motor mode is not confirmed by", enabled=True)
        self._refuse_errors(self._errors)
        if not self._dialect.has_registers:
            self._check_watchdogs()
            self._send_confirmed(frames, "motor mode is not confirmed by", enabled=True)
        self._powered = True
        self._command, self._commanded_s = self._zero_torque(), self._clock.now_s()

    def _refuse_errors(self, errors: Sequence[int]) -> None:
        """DeviceError: some motors have errors; with their names."""
        problems = [
            f"{self.motor_label(joint)}: {error_name(self._own.maker, error)}"
            for joint, error in enumerate(errors)
            if error
        ]
        if problems:
            raise DeviceError(f"{self.line.label}: {'; '.join(problems)}: remove the cause, then restart it")

    def _check_ranges(self) -> None:
        """That the numbers on the wire mean what the robot file says. DeviceError: they do not."""
        for joint, ranges in enumerate(self._ranges):
            for register, stated in (
                (registers.POSITION_RANGE, ranges.position_rad),
                (registers.VELOCITY_RANGE, ranges.velocity_rad_s),
                (registers.TORQUE_RANGE, ranges.torque_nm),
            ):
                found = self._register(joint, register)
                if not abs(found - stated) <= _SAME_RANGE * stated:
                    problem = f"its {register.name} is {found:g}, the robot file says {stated:g}"
                    raise self._about(joint, f"{problem}: state its 'ranges', or set the motor")

    def _set_up(self) -> None:
        """Set mode and CAN timeout, and forget that it has fired.

        DeviceError: a motor did not take them, or has another error.
        """
        timeout = round(self._own.watchdog_s / registers.TIMEOUT_STEP_S)
        for joint in range(self.joint_count):
            for register, value in (
                (registers.CONTROL_MODE, registers.MIT_MODE),
                (registers.CAN_TIMEOUT, timeout),
            ):
                self._register(joint, register, value)
                found = self._register(joint, register)
                if found != value:
                    raise self._about(joint, f"its {register.name} is {found:g} after it was set to {value}")
        self._leave_motor_mode()
        fired = self._dialect.timeout_error
        self._refuse_errors([0 if error == fired else error for error in self._errors])
        clear = self._to_every_motor(mit.CLEAR_ERROR)
        self._send_all([frame for frame, error in zip(clear, self._errors, strict=True) if error == fired])

    def _register(self, joint: int, register: MotorRegister, value: float | None = None) -> float:
        """A register's value, after it was set to `value` if there is one. DeviceError: no answer."""
        motor_id = self._motors[joint].motor_id
        frame = registers.read_register(motor_id, register)
        if value is not None:
            frame = registers.write_register(motor_id, register, value)
        self._register_asked, self._register_values = (joint, register), []
        try:
            self._send_all([frame])
            self._wait_for(lambda: bool(self._register_values), _ANSWER_S)
        finally:
            self._register_asked = None
        if not self._register_values:
            raise self._about(joint, f"does not say its {register.name}")
        return self._register_values[0]

    def _about(self, joint: int, problem: str) -> DeviceError:
        return DeviceError(f"{self.line.label}: {self.motor_label(joint)}: {problem}")

    def _check_watchdogs(self) -> None:
        """Let every motor exert a little, and say nothing for longer than it may go on with that.

        Asked by the frame that enters motor mode, for a motor may have left it.

        DeviceError: a motor goes on, or shows no torque at all.
        """
        trial_nm = [
            _TRIAL_SHARE * ranges.torque_nm * abs(motor.signed_ratio)
            for ranges, motor in zip(self._ranges, self._motors, strict=True)
        ]
        trial = [self._encode_torque(joint, torque_nm)[0] for joint, torque_nm in enumerate(trial_nm)]
        silence_s = _LATEST_WATCHDOG * self._own.watchdog_s
        self._exerting(trial, trial_nm)
        self._clock.sleep_until(self._clock.now_s() + _TRIAL_S)
        exerting = self._exerting(trial, trial_nm)
        self._clock.sleep_until(self._clock.now_s() + silence_s)
        going_on = self._exerting(self._to_every_motor(mit.ENTER_MOTOR_MODE), trial_nm)
        if not all(exerting):
            idle = self.motor_label(exerting.index(False))
            raise DeviceError(f"{self.line.label}: {idle} shows no torque when told to exert some")
        if any(going_on):
            alive = ", ".join(self.motor_label(joint) for joint, on in enumerate(going_on) if on)
            raise DeviceError(
                f"{self.line.label}: {alive} still exerts torque after {silence_s:.2g} s without commands; "
                f"set the CAN timeout to {self._own.watchdog_s:g} s in the motor"
            )

    def _exerting(self, frames: list[CanFrame], trial_nm: list[float]) -> list[bool]:
        """Whether the answers to `frames`, one to each motor, show at least half of torques (n) [N m]."""
        self._answers = [0] * self.joint_count
        self._send_all(frames)
        if not self._wait_for(lambda: all(self._answers), _ANSWER_S):
            silent = self.motor_label(self._answers.index(0))
            raise DeviceError(f"{self.line.label}: no answer in {_ANSWER_S} s from {silent}")
        return [torque >= 0.5 * trial for torque, trial in zip(self._torque_nm, trial_nm, strict=True)]

    def power_off(self) -> None:
        """See `MotorBus.power_off`; each motor must answer, be it on or off already and deaf to commands."""
        self._powered = False
        self._staged = []
        if not self.line.is_open:
            return
        self._leave_motor_mode()

    def _leave_motor_mode(self) -> None:
        leave = self._to_every_motor(mit.EXIT_MOTOR_MODE)
        frames = [*self._zero_torque(), *leave, *leave]
        self._send_confirmed(frames, "torque off is not confirmed by", enabled=False)

    def poll(self, deadline_s: float) -> None:
        """See `MotorBus.poll`; where no command has been sent since the last poll, asks for the next one."""
        try:
            super().poll(deadline_s)
        finally:
            if not self.line.bus_off:
                self._request_states()
            self._flushed = False

    def flush(self, deadline_s: float) -> None:
        if self._staged:
            self._commanded_s, self._command, self._flushed = self._clock.now_s(), self._staged, True
        super().flush(deadline_s)

    def _request_states(self) -> None:
        """Make the motors answer: say the last command again, but not for longer than the watchdog's time."""
        if not self._powered:
            self._ask()
        elif not self._flushed:
            forgotten = self._clock.now_s() - self._commanded_s > self._own.watchdog_s
            self._send_all(self._zero_torque() if forgotten else self._command)

    def _ask(self) -> None:
        if self._own.ask_with == "exit":
            self._send_all(self._to_every_motor(mit.EXIT_MOTOR_MODE))
        else:
            # Asked this way a motor has power, at zero torque, until the frame after the next is there.
            enter, leave = mit.ENTER_MOTOR_MODE, mit.EXIT_MOTOR_MODE
            self._send_all([*self._to_every_motor(enter), *self._zero_torque(), *self._to_every_motor(leave)])

    def _to_every_motor(self, special: bytes) -> list[CanFrame]:
        return [CanFrame(motor.motor_id, special) for motor in self._motors]

    def _zero_torque(self) -> list[CanFrame]:
        return [self._encode_torque(joint, 0.0)[0] for joint in range(self.joint_count)]

    def _send_confirmed(self, frames: list[CanFrame], problem: str, *, enabled: bool) -> None:
        """Send frames, two or more to each motor, and wait until each has answered twice.

        One that says whether it is in motor mode must say `enabled`, or that it has an error.
        """
        self._answers = [0] * self.joint_count
        self._send_all(frames)

        def missing() -> list[str]:
            wrong = [
                not error and found not in (None, enabled)
                for error, found in zip(self._errors, self._enabled, strict=True)
            ]
            return [
                self.motor_label(joint)
                for joint, answers in enumerate(self._answers)
                if answers < 2 or wrong[joint]
            ]

        if not self._wait_for(lambda: not missing(), _ANSWER_S):
            raise DeviceError(f"{self.line.label}: {problem} {', '.join(missing())}")

    def _joint_of(self, frame: CanFrame) -> int | None:
        if frame.extended or frame.remote or not frame.data:
            return None
        joint = self._joint_by_id.get(frame.data[0] & (0xF if self._dialect.has_registers else 0xFF))
        return None if joint is None or frame.can_id not in self._answer_ids[joint] else joint

    def _take(self, frame: CanFrame, at_s: float) -> bool:
        joint = self._joint_of(frame)
        if joint is None:
            return False
        motor = self._motors[joint]
        if self._dialect.has_registers and registers.is_about_register(frame, motor.motor_id):
            if self._register_asked and self._register_asked[0] == joint:
                with suppress(ProtocolError):  # about another one
                    value = registers.decode_register(frame, motor.motor_id, self._register_asked[1])
                    self._register_values.append(value)
            return True
        state = mit.decode_state(frame, self._ranges[joint], status_beside_id=self._dialect.has_registers)
        self._position_rad[joint] = motor.joint_angle_rad(state.position_rad)
        self._velocity_rad_s[joint] = state.velocity_rad_s / motor.signed_ratio
        self._torque_nm[joint] = state.torque_nm * motor.signed_ratio
        self._motion_at_s[joint] = self._torque_at_s[joint] = at_s - self._latency_s[joint]
        self._at_range_end[joint] = state.at_range_end
        self._errors[joint], self._enabled[joint] = state.error, state.enabled
        self._answers[joint] += 1
        self._motion_is_wrong[joint] = bool(state.error) and state.error == self._dialect.encoder_fault
        return True

    def _encode_torque(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        motor, ranges = self._motors[joint], self._ranges[joint]
        shaft_nm = torque_nm / motor.signed_ratio
        frame = mit.encode_torque(motor.motor_id, shaft_nm, ranges)
        return frame, mit.as_sent(shaft_nm, ranges) * motor.signed_ratio

    def _fault(self, joint: int, now_s: float) -> str:
        error = self._errors[joint]
        if not error and self._powered and self._enabled[joint] is False:
            return "has left motor mode; has it restarted?"
        return error_name(self._own.maker, error) if error else ""


class MitEncoder(MotorEncoder):
    """Positions and velocities that MIT-mode motors report; the settings are the bus's."""

    name = "mit_encoder"
    bus_type = MitBus


class MitTorque(MotorTorque):
    """Torques to and from MIT-mode motors; the settings are the bus's."""

    name = "mit_torque"
    bus_type = MitBus
