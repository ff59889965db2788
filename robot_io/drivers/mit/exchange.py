"""What goes over the wire between a host and motors in MIT mode: orders, torques, registers, and answers."""

from collections.abc import Mapping
from contextlib import suppress

from robot_io.driver import DriverContext
from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.can.motors import MotorBus
from robot_io.drivers.mit.frames import Order
from robot_io.drivers.mit.protocol import MitState
from robot_io.drivers.mit.registers import MotorRegister
from robot_io.drivers.mit.settings import MitBusSettings
from robot_io.errors import DeviceError, ProtocolError

ANSWER_S = 0.05  # more than any motor takes


class MitExchange(MotorBus):
    """MIT-mode motors as they are asked and answer, whoever made them."""

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        own = context.settings_as(MitBusSettings, settings)
        super().__init__(own, own.motors, context)
        self._own = own
        self._motors = own.motors
        self._dialect = own.dialect
        self._ranges = [own.wire_ranges(motor) for motor in own.motors]
        answer_ids = {motor.motor_id: own.answer_ids(motor) for motor in own.motors}
        self._frames = own.dialect.frames(own.host, answer_ids)
        self._joint_by_id = {motor.motor_id: joint for joint, motor in enumerate(own.motors)}
        self._errors, self._alarms = [0] * len(own.motors), [0] * len(own.motors)
        self._enabled: list[bool | None] = [None] * len(own.motors)
        self._register_asked: tuple[int, MotorRegister] | None = None  # and its joint, while awaited
        self._register_values: list[float] = []
        self._answers = [0] * len(own.motors)

    def motor_label(self, joint: int) -> str:
        return f"joint {joint + 1} (motor {self._motors[joint].motor_id})"

    def _joint_of(self, frame: CanFrame) -> int | None:
        sender = self._frames.sender(frame)
        return None if sender is None else self._joint_by_id.get(sender)

    def _take(self, frame: CanFrame, at_s: float) -> bool:
        joint = self._joint_of(frame)
        if joint is None:
            return False
        motor = self._motors[joint]
        if self._frames.is_about_register(frame, motor.motor_id):
            self._take_register(joint, frame)
        elif (alarm := self._frames.alarm(frame)) is not None:
            self._alarms[joint] = alarm
        else:
            self._take_state(joint, self._frames.state(frame, self._ranges[joint]), at_s)
        return True

    def _take_register(self, joint: int, frame: CanFrame) -> None:
        if self._register_asked and self._register_asked[0] == joint:
            with suppress(ProtocolError):  # about another one
                register = self._register_asked[1]
                value = self._frames.register_value(frame, self._motors[joint].motor_id, register)
                self._register_values.append(value)

    def _take_state(self, joint: int, state: MitState, at_s: float) -> None:
        motor = self._motors[joint]
        self._position_rad[joint] = motor.joint_angle_rad(state.position_rad)
        self._velocity_rad_s[joint] = state.velocity_rad_s / motor.signed_ratio
        self._torque_nm[joint] = state.torque_nm * motor.signed_ratio
        self._motion_at_s[joint] = self._torque_at_s[joint] = at_s - self._latency_s[joint]
        self._at_range_end[joint] = state.at_range_end
        self._errors[joint], self._enabled[joint] = state.error, state.enabled
        self._answers[joint] += 1
        self._motion_is_wrong[joint] = self._dialect.is_encoder_fault(state.error)

    def _encode_torque(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        motor = self._motors[joint]
        ratio = motor.signed_ratio
        frame, sent_nm = self._frames.torque(motor.motor_id, torque_nm / ratio, self._ranges[joint])
        return frame, sent_nm * ratio

    def _fault(self, joint: int, now_s: float) -> str:
        error = self._error(joint)
        if not error and self._powered and self._enabled[joint] is False:
            return "has left motor mode; has it restarted?"
        return self._dialect.error_names(error) if error else ""

    def _error(self, joint: int) -> int:
        """What is wrong with a motor by its last state, and by what it told unasked; 0 is nothing."""
        return self._errors[joint] | self._alarms[joint]

    def _to_every_motor(self, order: Order) -> list[CanFrame]:
        return [self._frames.order(motor.motor_id, order) for motor in self._motors]

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
                not self._error(joint) and found not in (None, enabled)
                for joint, found in enumerate(self._enabled)
            ]
            return [
                self.motor_label(joint)
                for joint, answers in enumerate(self._answers)
                if answers < 2 or wrong[joint]
            ]

        if not self._wait_for(lambda: not missing(), ANSWER_S):
            raise DeviceError(f"{self.line.label}: {problem} {', '.join(missing())}")

    def _answered(self, frames: list[CanFrame]) -> None:
        """Send one frame to each motor and wait for the answers. DeviceError: a motor is silent."""
        self._answers = [0] * self.joint_count
        self._send_all(frames)
        if not self._wait_for(lambda: all(self._answers), ANSWER_S):
            silent = self.motor_label(self._answers.index(0))
            raise DeviceError(f"{self.line.label}: no answer in {ANSWER_S} s from {silent}")

    def _register(self, joint: int, register: MotorRegister, value: float | None = None) -> float:
        """A register's value, after it was set to `value` if there is one. DeviceError: no answer."""
        motor_id = self._motors[joint].motor_id
        write = [] if value is None else [self._frames.write_register(motor_id, register, value)]
        self._register_asked, self._register_values = (joint, register), []
        try:
            self._send_all([*write, self._frames.read_register(motor_id, register)])
            self._wait_for(lambda: bool(self._register_values), ANSWER_S)
        finally:
            self._register_asked = None
        if not self._register_values:
            raise self._about(joint, f"does not say its {register.name}")
        return self._register_values[0]

    def _about(self, joint: int, problem: str) -> DeviceError:
        return DeviceError(f"{self.line.label}: {self.motor_label(joint)}: {problem}")
