"""How each maker's motors are spoken to: the frames for what a bus of MIT-mode motors has to say."""

import struct
from collections.abc import Mapping
from enum import StrEnum
from typing import ClassVar

from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.mit import protocol as mit
from robot_io.drivers.mit.protocol import MitRanges, MitState
from robot_io.drivers.mit.registers import READ, REGISTERS_ID, WRITE, MotorRegister
from robot_io.errors import ProtocolError


class Order(StrEnum):
    """What every motor can be told beside a torque."""

    ENTER = "enter motor mode"
    LEAVE = "leave motor mode"
    CLEAR = "forget an error"


class MitFrames:
    """Frames of the Mini Cheetah's firmware, as CubeMars' motors and others have it.

    Some motors answer to `host_id`; `answer_ids` are the arbitration ids of each motor's answers, by its id.
    """

    _ORDERS: ClassVar = {Order.ENTER: mit.ENTER_MOTOR_MODE, Order.LEAVE: mit.EXIT_MOTOR_MODE}
    _ID_BITS, _STATUS_BESIDE_ID = 0xFF, False
    extended = False

    def __init__(self, host_id: int, answer_ids: Mapping[int, tuple[int, ...]]) -> None:
        self.host_id, self._answer_ids = host_id, answer_ids

    def order(self, motor_id: int, order: Order) -> CanFrame:
        """Tell a motor to do something; it answers with its state."""
        return CanFrame(motor_id, self._ORDERS[order])

    def torque(self, motor_id: int, torque_nm: float, ranges: MitRanges) -> tuple[CanFrame, float]:
        """The frame for a torque at the output shaft [N m], and what it says, after rounding [N m]."""
        return mit.encode_torque(motor_id, torque_nm, ranges)

    def motor_asked(self, frame: CanFrame) -> int | None:
        """Which motor answers a frame of the host's with its state; None if none does."""
        return None if frame.can_id == REGISTERS_ID else frame.can_id

    def sender(self, frame: CanFrame) -> int | None:
        """Which motor a frame comes from; None if it is no answer of one of ours."""
        if frame.extended or frame.remote or not frame.data:
            return None
        motor_id = frame.data[0] & self._ID_BITS
        return motor_id if frame.can_id in self._answer_ids.get(motor_id, ()) else None

    def state(self, frame: CanFrame, ranges: MitRanges) -> MitState:
        """What a motor answers. ProtocolError: it is no state."""
        return mit.decode_state(frame, ranges, status_beside_id=self._STATUS_BESIDE_ID)

    def is_about_register(self, frame: CanFrame, motor_id: int) -> bool:
        """Whether an answer is about a register, and no state."""
        return False

    def alarm(self, frame: CanFrame) -> int | None:
        """Errors that a motor tells unasked, None where a frame tells none."""
        return None

    def read_register(self, motor_id: int, register: MotorRegister) -> CanFrame:
        """Ask for a register's value."""
        return _registers(motor_id, bytes((READ, register.number, 0, 0, 0, 0)))

    def write_register(self, motor_id: int, register: MotorRegister, value: float) -> CanFrame:
        """Set a register; what is set is lost without power."""
        number = int(value) if register.format == "<I" else value
        data = bytes((WRITE, register.number)) + struct.pack(register.format, number)
        return _registers(motor_id, data)

    def register_value(self, frame: CanFrame, motor_id: int, register: MotorRegister) -> float:
        """The value in an answer. ProtocolError: it is about another register, or says that there is none."""
        data = frame.data
        if not _is_about_register(frame, motor_id) or data[2] != READ:
            raise ProtocolError(f"no answer of motor {motor_id} about a register: {data.hex(' ')}")
        if data[3] != register.number:
            raise ProtocolError(f"register {data[3]} in place of {register.number}")
        (value,) = struct.unpack(register.format, data[4:])
        return float(value)


class DamiaoFrames(MitFrames):
    """Damiao's: four bits of the id with a status above, an order more, and registers."""

    _ORDERS: ClassVar = {**MitFrames._ORDERS, Order.CLEAR: mit.CLEAR_ERROR}
    _ID_BITS, _STATUS_BESIDE_ID = 0xF, True

    def is_about_register(self, frame: CanFrame, motor_id: int) -> bool:
        """See `MitFrames`; a state that looks so would be near the range's end."""
        return _is_about_register(frame, motor_id)


def _registers(motor_id: int, data: bytes) -> CanFrame:
    return CanFrame(REGISTERS_ID, motor_id.to_bytes(2, "little") + data)


def _is_about_register(frame: CanFrame, motor_id: int) -> bool:
    head = motor_id.to_bytes(2, "little")
    return len(frame.data) == 8 and frame.data[:2] == head and frame.data[2] in (READ, WRITE)
