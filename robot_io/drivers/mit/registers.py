"""Registers of Damiao motors, read and written over CAN; no adapters, no clocks.

A frame to id 7FF holds the motor's id (2 bytes, little-endian), 33 to read or 55 to write, the register's
number, and its value (4 bytes, a float or an integer). The motor answers with the same bytes under its own
answer id. Source: Damiao, "DM-J4310-2EC user manual", register list.
"""

import struct
from dataclasses import dataclass
from typing import Final

from robot_io.drivers.can.line import CanFrame
from robot_io.errors import ProtocolError

REGISTERS_ID: Final = 0x7FF
_READ, _WRITE = 0x33, 0x55


@dataclass(frozen=True, slots=True)
class MotorRegister:
    """One value of a motor."""

    name: str  # as in the manual
    number: int  # of the register, or Robstride's index
    format: str  # of its four bytes, for struct


CAN_TIMEOUT: Final = MotorRegister("CAN timeout", 9, "<I")  # 50 us
CONTROL_MODE: Final = MotorRegister("control mode", 10, "<I")
POSITION_RANGE: Final = MotorRegister("PMAX", 21, "<f")  # rad
VELOCITY_RANGE: Final = MotorRegister("VMAX", 22, "<f")  # rad/s
TORQUE_RANGE: Final = MotorRegister("TMAX", 23, "<f")  # N m

MIT_MODE: Final = 1
TIMEOUT_STEP_S: Final = 50e-6


def read_register(motor_id: int, register: MotorRegister) -> CanFrame:
    """Ask for a value."""
    return CanFrame(
        REGISTERS_ID, motor_id.to_bytes(2, "little") + bytes((_READ, register.number, 0, 0, 0, 0))
    )


def write_register(motor_id: int, register: MotorRegister, value: float) -> CanFrame:
    """Set a value; it is lost without power."""
    number = int(value) if register.format == "<I" else value
    data = struct.pack(register.format, number)
    return CanFrame(REGISTERS_ID, motor_id.to_bytes(2, "little") + bytes((_WRITE, register.number)) + data)


def is_about_register(frame: CanFrame, motor_id: int) -> bool:
    """Whether a motor's answer is about a register; a state that looks so would be near the range's end."""
    head = motor_id.to_bytes(2, "little")
    return len(frame.data) == 8 and frame.data[:2] == head and frame.data[2] in (_READ, _WRITE)


def decode_register(frame: CanFrame, motor_id: int, register: MotorRegister) -> float:
    """The value that was asked for. ProtocolError: it is another motor's, of another register, or none."""
    if not is_about_register(frame, motor_id) or frame.data[2] != _READ:
        raise ProtocolError(f"no answer of motor {motor_id} about a register: {frame.data.hex(' ')}")
    if frame.data[3] != register.number:
        raise ProtocolError(f"register {frame.data[3]} in place of {register.number}")
    (value,) = struct.unpack(register.format, frame.data[4:])
    return float(value)
