"""What goes over the wire between a host and motors in MIT mode: orders, torques, registers, and answers."""

from collections.abc import Mapping
from contextlib import suppress

from robot_io.driver import DriverContext
from robot_io.drivers.can.asked import ANSWER_S, AskedMotorBus
from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.mit.frames import Order
from robot_io.drivers.mit.protocol import MitState
from robot_io.drivers.mit.registers import MotorRegister
from robot_io.drivers.mit.settings import MitBusSettings
from robot_io.errors import ProtocolError


class MitExchange(AskedMotorBus[MitState]):
    """MIT-mode motors as they are asked and answer, whoever made them."""

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        own = context.settings_as(MitBusSettings, settings)
        ids = [motor.motor_id for motor in own.motors]
        super().__init__(own, own.motors, context, ids, own.watchdog_s)
        self._own = own
        self._motors = own.motors
        self._dialect = own.dialect
        self._ranges = [own.wire_ranges(motor) for motor in own.motors]
        answer_ids = {motor.motor_id: own.answer_ids(motor) for motor in own.motors}
        self._frames = own.dialect.frames(own.host, answer_ids)
        self._alarms = [0] * len(own.motors)  # errors that were told unasked
        self._register_asked: tuple[int, MotorRegister] | None = None  # and its joint, while awaited
        self._register_values: list[float] = []

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
            self._states[joint].append((self._frames.state(frame, self._ranges[joint]), at_s))
        return True

    def _motor_asked(self, frame: CanFrame) -> int | None:
        return self._frames.motor_asked(frame)

    def _take_register(self, joint: int, frame: CanFrame) -> None:
        if self._register_asked and self._register_asked[0] == joint:
            with suppress(ProtocolError):  # about another one
                register = self._register_asked[1]
                value = self._frames.register_value(frame, self._motors[joint].motor_id, register)
                self._register_values.append(value)

    def _condition(self, state: MitState) -> tuple[int, bool | None]:
        return state.error, state.enabled

    def _keep(self, joint: int, state: MitState, asked_s: float) -> None:
        motor = self._motors[joint]
        self._position_rad[joint] = motor.joint_angle_rad(state.position_rad)
        self._velocity_rad_s[joint] = state.velocity_rad_s / motor.signed_ratio
        self._torque_nm[joint] = state.torque_nm * motor.signed_ratio
        self._motion_at_s[joint] = self._torque_at_s[joint] = asked_s
        self._at_range_end[joint] = state.at_range_end
        self._motion_is_wrong[joint] = self._dialect.is_encoder_fault(state.error)

    def _encode_torque(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        motor = self._motors[joint]
        ratio = motor.signed_ratio
        frame, sent_nm = self._frames.torque(motor.motor_id, torque_nm / ratio, self._ranges[joint])
        return frame, sent_nm * ratio

    @property
    def _foreign_remedy(self) -> str:
        """See `MotorBus`; Damiao's motors are delivered with a master id of 0."""
        if not self._dialect.has_answer_ids:
            return super()._foreign_remedy
        ids = ", ".join(f"0x{self._own.answer_ids(motor)[0]:03X}" for motor in self._motors)
        return f"set the master id of each motor ({ids} by the robot file), or state its answer_id"

    def _error_names(self, error: int) -> str:
        return self._dialect.error_names(error)

    def _error(self, joint: int) -> int:
        return self._errors[joint] | self._alarms[joint]

    def _refuse_errors(self, but: int | None = None) -> None:
        """See `AskedMotorBus._refuse_errors`; what was told unasked is named once, then states count."""
        try:
            super()._refuse_errors(but)
        finally:
            self._alarms = [0] * self.joint_count

    def _to_every_motor(self, order: Order) -> list[CanFrame]:
        return [self._frames.order(motor.motor_id, order) for motor in self._motors]

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
