"""Registers of Damiao motors, read and written over CAN.

A frame to id 7FF holds the motor's id (2 bytes, little-endian), 33 to read or 55 to write, the register's
number, and its value (4 bytes, a float or an integer). The motor answers with the same bytes under its own
answer id. Source: Damiao, "DM-J4310-2EC user manual", register list.
"""

from dataclasses import dataclass
from typing import Final

REGISTERS_ID: Final = 0x7FF
READ, WRITE = 0x33, 0x55


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
