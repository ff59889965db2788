"""Protocol of motors in MIT mode, which packs motion, gains and feed-forward torque into eight bytes.

Big-endian: position 16 bits, velocity 12, KP 12, KD 12, torque 12. An n bit number x stands for low + x (high
- low) / (2^n - 1); the ranges depend on the model, or are stated in the robot file.
Sources: CubeMars "AK Series Actuator Driver Manual" V1.0.8, section 5.3 (frames, special codes); Damiao,
"DM-J4310-2EC user manual" (feedback frame, registers). The protocol is that of the MIT Mini Cheetah's motor
controller; `settings` holds the differences between makers.

Damiao's motors have registers. A frame to id 7FF holds the motor's id (2 bytes, little-endian), 33 to read or
55 to write, the register's number, and its value (4 bytes, a float or an integer). The motor answers with the
same bytes under its own answer id. Source: Damiao, "DM-J4310-2EC user manual", register list.

Robstride's motors use 16 bits for each number, in frames with 29 bit ids. An id holds the frame's type (5
bits), 16 bits whose meaning depends on the type, and the receiver (8 bits). The 16 bits of a command are its
torque; those of a state are mode, faults and sender. Further faults come in frames of their own type.
Sources: RobStride, user manuals of RS00 to RS06 of 2026-04-28, section 4.1 (frames, fault bits, parameters),
and section 3.3.6 (CAN timeout); byte order of faults and the status of a parameter that could not be read:
RobStride/Python_Sample, huggingface/lerobot#4070 (tried on RS00, RS03 and RS06).
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import isnan
from typing import ClassVar, Final

from palpate.robot_io.drivers.can.line import CanFrame, expect_length
from palpate.robot_io.errors import InputError, ProtocolError


@dataclass(frozen=True, slots=True)
class MitRanges:
    """Ranges of the numbers in a motor's frames; each is from minus to plus the value."""

    position_rad: float  # of the output shaft [rad]
    velocity_rad_s: float  # of the output shaft [rad/s]
    torque_nm: float  # at the output shaft [N m]


ENTER_MOTOR_MODE = b"\xff\xff\xff\xff\xff\xff\xff\xfc"
EXIT_MOTOR_MODE = b"\xff\xff\xff\xff\xff\xff\xff\xfd"
CLEAR_ERROR = b"\xff\xff\xff\xff\xff\xff\xff\xfb"  # Damiao

MAX_16 = (1 << 16) - 1
_MAX_12 = (1 << 12) - 1
_ONLY_TORQUE = 0x8000 << 48 | 0x800 << 36  # command of a torque: zero position, velocity and gains


@dataclass(frozen=True, slots=True)
class MitState:
    """State of a motor."""

    motor_id: int  # CAN id of the motor
    position_rad: float  # of the output shaft [rad]
    velocity_rad_s: float  # of the output shaft [rad/s]
    torque_nm: float  # at the output shaft [N m]
    # Whether position or velocity is at the end of its range, so that the true value may lie beyond.
    at_range_end: bool
    torque_at_end: bool  # whether the torque is
    error: int  # see `MitProtocol.errors`; 0 is none, or old firmware that does not send it
    # Whether the motor is in motor mode; None if it does not report that.
    enabled: bool | None


def _to_bits(value: float, half_range: float, largest: int) -> int:
    """Encode a value from -half_range to half_range, clipped, as 0 to `largest`; `InputError` for NaN."""
    if isnan(value):
        raise InputError("a motor command is not a number")
    return round((min(max(value, -half_range), half_range) + half_range) / (2.0 * half_range) * largest)


def _from_bits(bits: float, half_range: float, largest: int) -> float:
    """Decode what `_to_bits` encoded."""
    return (2.0 * bits / largest - 1.0) * half_range


def _reading(bits: int, half_range: float, largest: int) -> float:
    """Decode a reading, which the firmware truncates: the true value is half a step higher on average.

    A reading at an end of the range is clipped, and is not changed.
    """
    return _from_bits(bits + 0.5 if 0 < bits < largest else bits, half_range, largest)


REGISTERS_ID: Final = 0x7FF
READ, WRITE = 0x33, 0x55


@dataclass(frozen=True, slots=True)
class MotorRegister:
    """One register of a motor; Robstride calls it a parameter."""

    name: str  # name in the manual
    number: int  # number of the register, or Robstride's index
    format: str  # struct format of its four bytes


DAMIAO_CAN_TIMEOUT: Final = MotorRegister("CAN timeout", 9, "<I")  # in steps of 50 us
CONTROL_MODE: Final = MotorRegister("control mode", 10, "<I")
POSITION_RANGE: Final = MotorRegister("PMAX", 21, "<f")  # rad
VELOCITY_RANGE: Final = MotorRegister("VMAX", 22, "<f")  # rad/s
TORQUE_RANGE: Final = MotorRegister("TMAX", 23, "<f")  # N m

MIT_MODE: Final = 1
TIMEOUT_STEP_S: Final = 50e-6


class MotorCommand(StrEnum):
    """Commands other than torques; only motors of Damiao and Robstride support `CLEAR`."""

    ENTER = "enter motor mode"
    LEAVE = "leave motor mode"
    CLEAR = "clear an error"


class MitFrames:
    """Frames of the Mini Cheetah's firmware, which CubeMars' motors and others use.

    Args:
        host_id: CAN id of the host, to which some motors answer.
        answer_ids: arbitration ids of each motor's answers, by its CAN id.
    """

    _COMMANDS: ClassVar = {MotorCommand.ENTER: ENTER_MOTOR_MODE, MotorCommand.LEAVE: EXIT_MOTOR_MODE}
    _ID_BITS, _STATUS_BESIDE_ID, _HAS_REGISTERS = 0xFF, False, False
    extended = False

    def __init__(self, host_id: int, answer_ids: Mapping[int, tuple[int, ...]]) -> None:
        self.host_id, self._answer_ids = host_id, answer_ids

    def order(self, motor_id: int, order: MotorCommand) -> CanFrame:
        """Make the frame of an order; the motor answers with its state.

        Args:
            motor_id: CAN id of the receiver.
            order: the order.
        """
        return CanFrame(motor_id, self._COMMANDS[order])

    def torque(self, motor_id: int, torque_nm: float, ranges: MitRanges) -> tuple[CanFrame, float]:
        """Make the frame for a torque at the shaft, clipped to the range; return also the torque sent [N m].

        Zero lies halfway between two numbers, because their count is even; it is encoded as plus half a step.

        Args:
            motor_id: id of the receiver.
            torque_nm: torque at the output shaft [N m].
            ranges: ranges of the motor's model.

        Raises:
            InputError: the torque is not a number.
        """
        bits = _to_bits(torque_nm, ranges.torque_nm, _MAX_12)
        frame = CanFrame(motor_id, (_ONLY_TORQUE | bits).to_bytes(8, "big"))
        return frame, _from_bits(bits, ranges.torque_nm, _MAX_12)

    def answering_motor(self, frame: CanFrame) -> int | None:
        """Return the id of the motor that will answer a frame with its state; None if none will.

        Args:
            frame: frame from the host.
        """
        return None if frame.can_id == REGISTERS_ID else frame.can_id

    def sender(self, frame: CanFrame) -> int | None:
        """Return the id of the motor that sent a frame; None if no motor of this bus did.

        Args:
            frame: the received frame.
        """
        if frame.extended or frame.remote or not frame.data:
            return None
        motor_id = frame.data[0] & self._ID_BITS
        return motor_id if frame.can_id in self._answer_ids.get(motor_id, ()) else None

    def state(self, frame: CanFrame, ranges: MitRanges) -> MitState:
        """Parse the answer of a motor: id 8 bits, position 16, velocity 12, torque 12; temperature and error.

        The Mini Cheetah's firmware sends the first six bytes, newer versions of it a supply voltage as well.
        With `_STATUS_BESIDE_ID`, the id is the lower four bits of the first byte, and the upper four are a
        status: 0 is off, 1 is on, larger is an error. The last two bytes are then temperatures.

        Args:
            frame: the received frame.
            ranges: ranges of the motor's model.

        Raises:
            ProtocolError: the frame is not a state.
        """
        expect_length(frame, "motor state", *((8,) if self._STATUS_BESIDE_ID else (6, 7, 8)))
        data = frame.data
        position = data[1] << 8 | data[2]
        velocity = data[3] << 4 | data[4] >> 4
        torque = (data[4] & 0xF) << 8 | data[5]
        motor_id, error, enabled = data[0], data[7] if len(data) == 8 else 0, None
        if self._STATUS_BESIDE_ID:
            motor_id, status = data[0] & 0xF, data[0] >> 4
            error, enabled = (status if status > 1 else 0), status == 1
        return MitState(
            motor_id=motor_id,
            position_rad=_reading(position, ranges.position_rad, MAX_16),
            velocity_rad_s=_reading(velocity, ranges.velocity_rad_s, _MAX_12),
            torque_nm=_reading(torque, ranges.torque_nm, _MAX_12),
            at_range_end=position in (0, MAX_16) or velocity in (0, _MAX_12),
            torque_at_end=torque in (0, _MAX_12),
            error=error,
            enabled=enabled,
        )

    def is_about_register(self, frame: CanFrame, motor_id: int) -> bool:
        """Check whether an answer is about a register instead of a state.

        Args:
            frame: the received frame.
            motor_id: CAN id of its sender.
        """
        head = motor_id.to_bytes(2, "little")
        is_register = len(frame.data) == 8 and frame.data[:2] == head and frame.data[2] in (READ, WRITE)
        return self._HAS_REGISTERS and is_register

    def alarm(self, frame: CanFrame) -> int | None:
        """Return errors and warnings that a motor reports without a request; None if the frame is another.

        Warnings are the bits of `WARNING_BITS`.

        Args:
            frame: the received frame.
        """
        return None

    def read_register(self, motor_id: int, register: MotorRegister) -> CanFrame:
        """Make the frame that requests a register's value.

        Args:
            motor_id: CAN id of the receiver.
            register: register to read.
        """
        data = motor_id.to_bytes(2, "little") + bytes((READ, register.number, 0, 0, 0, 0))
        return CanFrame(REGISTERS_ID, data)

    def write_register(self, motor_id: int, register: MotorRegister, value: float) -> CanFrame:
        """Make the frame that sets a register until the motor loses power.

        Args:
            motor_id: CAN id of the receiver.
            register: register to write.
            value: value in the register's own unit.
        """
        number = int(value) if register.format == "<I" else value
        data = motor_id.to_bytes(2, "little") + bytes((WRITE, register.number))
        return CanFrame(REGISTERS_ID, data + struct.pack(register.format, number))

    def register_value(self, frame: CanFrame, motor_id: int, register: MotorRegister) -> float:
        """Parse the value in an answer, in the register's own unit.

        Args:
            frame: the received frame.
            motor_id: CAN id of its sender.
            register: the register that was requested.

        Raises:
            ProtocolError: the value belongs to another register, or the register does not exist.
        """
        data = frame.data
        if not self.is_about_register(frame, motor_id) or data[2] != READ:
            raise ProtocolError(f"not a register answer of motor {motor_id}: {data.hex(' ')}")
        if data[3] != register.number:
            raise ProtocolError(f"the answer holds register {data[3]} instead of {register.number}")
        (value,) = struct.unpack(register.format, data[4:])
        return float(value)


class DamiaoFrames(MitFrames):
    """Damiao's frames: a status beside an id of four bits, an additional order, and registers.

    Only a state near the end of the position's range can have the same bytes as an answer about a register.
    """

    _COMMANDS: ClassVar = {**MitFrames._COMMANDS, MotorCommand.CLEAR: CLEAR_ERROR}
    _ID_BITS, _STATUS_BESIDE_ID, _HAS_REGISTERS = 0xF, True, True


RUN_MODE: Final = MotorRegister("run_mode", 0x7005, "<B3x")
OPERATION_CONTROL: Final = 0  # value of `RUN_MODE`: the mode that others call MIT mode
POSITION: Final = MotorRegister("mechPos", 0x7019, "<f")  # of the output shaft, over all turns [rad]
ROBSTRIDE_CAN_TIMEOUT: Final = MotorRegister("canTimeout", 0x7028, "<I")  # in steps of 50 us

_CONTROL, _STATE, _ENABLE, _STOP, _READ, _WRITE, _FAULTS = 1, 2, 3, 4, 17, 18, 21
_COMMANDS = {
    MotorCommand.ENTER: (_ENABLE, bytes(8)),
    MotorCommand.LEAVE: (_STOP, bytes(8)),
    MotorCommand.CLEAR: (_STOP, b"\x01" + bytes(7)),
}
_RUNNING, _MODE_COUNT = 2, 3
_ONLY_TORQUE_DATA = bytes((0x80, 0, 0x80, 0, 0, 0, 0, 0))  # as `_ONLY_TORQUE`; the torque is in the id
_FOUR_WORDS = struct.Struct(">4H")  # position, velocity, torque, temperature
FAULT_FRAME_BITS: Final = 8  # shift of the bits of a fault frame, above those of a state
WARNING_BITS: Final = 0xFFFFFFFF << 32 + FAULT_FRAME_BITS  # its second half


class RobstrideFrames(MitFrames):
    """Robstride's frames."""

    extended = True

    def order(self, motor_id: int, order: MotorCommand) -> CanFrame:
        kind, data = _COMMANDS[order]
        return self._frame(kind, self.host_id, motor_id, data)

    def torque(self, motor_id: int, torque_nm: float, ranges: MitRanges) -> tuple[CanFrame, float]:
        bits = _to_bits(torque_nm, ranges.torque_nm, MAX_16)
        return (
            self._frame(_CONTROL, bits, motor_id, _ONLY_TORQUE_DATA),
            _from_bits(bits, ranges.torque_nm, MAX_16),
        )

    def answering_motor(self, frame: CanFrame) -> int | None:
        return None if frame.can_id >> 24 == _READ else frame.can_id & 0xFF

    def sender(self, frame: CanFrame) -> int | None:
        is_answer = frame.extended and not frame.remote and frame.can_id & 0xFF == self.host_id
        known = is_answer and frame.can_id >> 24 in (_STATE, _READ, _FAULTS)
        return frame.can_id >> 8 & 0xFF if known else None

    def state(self, frame: CanFrame, ranges: MitRanges) -> MitState:
        expect_length(frame, "motor state", 8)
        mode = frame.can_id >> 22 & 3
        if frame.can_id >> 24 != _STATE or mode >= _MODE_COUNT:
            raise ProtocolError(f"not a state frame: id {frame.can_id:08X}")
        position, velocity, torque, _ = _FOUR_WORDS.unpack(frame.data)
        return MitState(
            motor_id=frame.can_id >> 8 & 0xFF,
            position_rad=_reading(position, ranges.position_rad, MAX_16),
            velocity_rad_s=_reading(velocity, ranges.velocity_rad_s, MAX_16),
            torque_nm=_reading(torque, ranges.torque_nm, MAX_16),
            at_range_end=position in (0, MAX_16) or velocity in (0, MAX_16),
            torque_at_end=torque in (0, MAX_16),
            error=frame.can_id >> 16 & 0x3F,
            enabled=mode == _RUNNING,
        )

    def alarm(self, frame: CanFrame) -> int | None:
        if frame.can_id >> 24 != _FAULTS:
            return None
        expect_length(frame, "faults", 8)
        return int.from_bytes(frame.data, "little") << FAULT_FRAME_BITS

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
        if frame.can_id != _READ << 24 | motor_id << 8 | self.host_id:  # bits 16 to 23 are 0 on success
            raise ProtocolError(f"not a parameter frame: id {frame.can_id:08X}")
        if frame.data[:4] != register.number.to_bytes(4, "little"):
            raise ProtocolError(f"expected parameter {register.number:04X}, received {frame.data.hex(' ')}")
        (value,) = struct.unpack(register.format, frame.data[4:])
        return float(value)

    @staticmethod
    def _frame(kind: int, middle: int, target: int, data: bytes) -> CanFrame:
        return CanFrame(kind << 24 | middle << 8 | target, data, extended=True)
