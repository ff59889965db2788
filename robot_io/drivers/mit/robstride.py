"""The protocol of Robstride motors: MIT mode with 16 bits for each number, in frames with 29 bit ids.

An id is what a frame is (5 bits), 16 bits that depend on it, and who it is for (8 bits). A command has its
torque in the id. A state has mode, faults and the sender there; other faults come in frames of their own.

Sources: RobStride, user manuals of RS00 to RS06 of 2026-04-28, section 4.1 (frames, fault bits, parameters),
and section 3.3.6 (CAN timeout); byte order of faults and the status of a parameter that could not be read:
RobStride/Python_Sample, huggingface/lerobot#4070 (tried on RS00, RS03 and RS06).
"""

import struct
from typing import Final

from robot_io.drivers.can.line import CanFrame, expect_length
from robot_io.drivers.mit.frames import MitFrames, Order
from robot_io.drivers.mit.protocol import MAX_16, MitRanges, MitState, from_bits, to_bits
from robot_io.drivers.mit.registers import MotorRegister
from robot_io.errors import ProtocolError

RUN_MODE: Final = MotorRegister("run_mode", 0x7005, "<B3x")
OPERATION_CONTROL: Final = 0  # a run mode: what others call MIT mode
POSITION: Final = MotorRegister("mechPos", 0x7019, "<f")  # of the output shaft, over all turns [rad]
CAN_TIMEOUT: Final = MotorRegister("canTimeout", 0x7028, "<I")  # 50 us

_CONTROL, _STATE, _ENABLE, _STOP, _READ, _WRITE, _FAULTS = 1, 2, 3, 4, 17, 18, 21
_ORDERS = {
    Order.ENTER: (_ENABLE, bytes(8)),
    Order.LEAVE: (_STOP, bytes(8)),
    Order.CLEAR: (_STOP, b"\x01" + bytes(7)),
}
_RUNNING, _MODES = 2, 3  # and how many modes there are
_ONLY_TORQUE = bytes((0x80, 0, 0x80, 0, 0, 0, 0, 0))  # position and velocity about zero, and both gains zero
_FOUR_WORDS = struct.Struct(">4H")  # position, velocity, torque, temperature
FAULT_FRAME_BITS: Final = 8  # faults of their own frames stand so far above those of a state


class RobstrideFrames(MitFrames):
    """Robstride's frames."""

    extended = True

    def order(self, motor_id: int, order: Order) -> CanFrame:
        kind, data = _ORDERS[order]
        return self._frame(kind, self.host_id, motor_id, data)

    def torque(self, motor_id: int, torque_nm: float, ranges: MitRanges) -> tuple[CanFrame, float]:
        bits = to_bits(torque_nm, -ranges.torque_nm, ranges.torque_nm, MAX_16)
        return self._frame(_CONTROL, bits, motor_id, _ONLY_TORQUE), from_bits(bits, ranges.torque_nm, MAX_16)

    def motor_asked(self, frame: CanFrame) -> int | None:
        return None if frame.can_id >> 24 == _READ else frame.can_id & 0xFF

    def sender(self, frame: CanFrame) -> int | None:
        is_answer = frame.extended and not frame.remote and frame.can_id & 0xFF == self.host_id
        known = is_answer and frame.can_id >> 24 in (_STATE, _READ, _FAULTS)
        return frame.can_id >> 8 & 0xFF if known else None

    def state(self, frame: CanFrame, ranges: MitRanges) -> MitState:
        expect_length(frame, "motor state", 8)
        mode = frame.can_id >> 22 & 3
        if frame.can_id >> 24 != _STATE or mode >= _MODES:
            raise ProtocolError(f"no state: id {frame.can_id:08X}")
        position, velocity, torque, _ = _FOUR_WORDS.unpack(frame.data)
        return MitState(
            motor_id=frame.can_id >> 8 & 0xFF,
            position_rad=from_bits(position, ranges.position_rad, MAX_16),
            velocity_rad_s=from_bits(velocity, ranges.velocity_rad_s, MAX_16),
            torque_nm=from_bits(torque, ranges.torque_nm, MAX_16),
            at_range_end=position in (0, MAX_16) or velocity in (0, MAX_16),
            error=frame.can_id >> 16 & 0x3F,
            enabled=mode == _RUNNING,
        )

    def alarm(self, frame: CanFrame) -> int | None:
        if frame.can_id >> 24 != _FAULTS:
            return None
        expect_length(frame, "faults", 8)
        return int.from_bytes(frame.data[:4], "little") << FAULT_FRAME_BITS

    def is_about_register(self, frame: CanFrame, motor_id: int) -> bool:
        return frame.can_id >> 24 == _READ

    def read_register(self, motor_id: int, register: MotorRegister) -> CanFrame:
        return self._frame(_READ, self.host_id, motor_id, register.number.to_bytes(2, "little") + bytes(6))

    def write_register(self, motor_id: int, register: MotorRegister, value: float) -> CanFrame:
        number = value if register.format == "<f" else int(value)
        data = register.number.to_bytes(4, "little") + struct.pack(register.format, number)
        return self._frame(_WRITE, self.host_id, motor_id, data)

    def register_value(self, frame: CanFrame, motor_id: int, register: MotorRegister) -> float:
        expect_length(frame, "parameter", 8)
        if frame.can_id != _READ << 24 | motor_id << 8 | self.host_id:  # between them: whether it failed
            raise ProtocolError(f"no parameter: id {frame.can_id:08X}")
        if frame.data[:4] != register.number.to_bytes(4, "little"):
            raise ProtocolError(f"no parameter {register.number:04X}: {frame.data.hex(' ')}")
        (value,) = struct.unpack(register.format, frame.data[4:])
        return float(value)

    @staticmethod
    def _frame(kind: int, middle: int, target: int, data: bytes) -> CanFrame:
        return CanFrame(kind << 24 | middle << 8 | target, data, extended=True)
