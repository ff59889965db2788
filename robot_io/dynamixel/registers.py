"""The registers of the X series that this package uses.

The addresses are the same in all models of `models`. Values are little-endian, signed ones in two's
complement.
Source: ROBOTIS e-manual, "Control Table" of XM430-W350, XM540-W270, XH540-W270, XL330-M077 and XL330-M288.
"""

from dataclasses import dataclass
from typing import Final

from robot_io.errors import ProtocolError


@dataclass(frozen=True, slots=True)
class Register:
    """One value of a servo.

    Attributes:
        name: as in the manual.
        address: of its first byte.
        size: bytes.
        signed: whether it can be negative.
    """

    name: str
    address: int
    size: int
    signed: bool = False

    def encode(self, value: int) -> bytes:
        """The bytes of a value.

        Raises:
            ProtocolError: it does not fit.
        """
        try:
            return value.to_bytes(self.size, "little", signed=self.signed)
        except OverflowError as error:
            raise ProtocolError(f"{value} does not fit into {self.name} ({self.size} bytes)") from error

    def decode(self, data: bytes) -> int:
        """The value of bytes.

        Raises:
            ProtocolError: not as many bytes as it has.
        """
        if len(data) != self.size:
            raise ProtocolError(f"{self.name} came with {len(data)} bytes instead of {self.size}")
        return int.from_bytes(data, "little", signed=self.signed)


# Kept without power; can be written while the torque is off.
RETURN_DELAY_TIME: Final = Register("return delay time", 9, 1)  # 2 us
DRIVE_MODE: Final = Register("drive mode", 10, 1)
OPERATING_MODE: Final = Register("operating mode", 11, 1)
MAX_VOLTAGE_LIMIT: Final = Register("max voltage limit", 32, 2)  # 0.1 V
MIN_VOLTAGE_LIMIT: Final = Register("min voltage limit", 34, 2)  # 0.1 V
CURRENT_LIMIT: Final = Register("current limit", 38, 2)

# Lost without power.
TORQUE_ENABLE: Final = Register("torque enable", 64, 1)
STATUS_RETURN_LEVEL: Final = Register("status return level", 68, 1)
HARDWARE_ERROR_STATUS: Final = Register("hardware error status", 70, 1)
BUS_WATCHDOG: Final = Register("bus watchdog", 98, 1, signed=True)  # 20 ms; -1: it has fired
GOAL_CURRENT: Final = Register("goal current", 102, 2, signed=True)
PRESENT_CURRENT: Final = Register("present current", 126, 2, signed=True)
PRESENT_VELOCITY: Final = Register("present velocity", 128, 4, signed=True)
PRESENT_POSITION: Final = Register("present position", 132, 4, signed=True)
PRESENT_INPUT_VOLTAGE: Final = Register("present input voltage", 144, 2)  # 0.1 V
PRESENT_TEMPERATURE: Final = Register("present temperature", 146, 1)  # degrees Celsius
INDIRECT_ADDRESS: Final = 168  # of the first of many, 2 bytes each

CURRENT_CONTROL: Final = 0  # operating mode
ANSWER_EVERYTHING: Final = 2  # status return level
WATCHDOG_FIRED: Final = -1

RETURN_DELAY_STEP_S: Final = 2e-6
WATCHDOG_STEP_S: Final = 0.020
LARGEST_RETURN_DELAY: Final = 254
LARGEST_WATCHDOG: Final = 127

_DRIVE_MODE_TROUBLE = {
    0x01: "reversed: set it to 0 and say 'reversed: true' in the robot file",
    0x02: "a slave of another servo",
    0x08: "switches its torque on by itself when it gets a goal",
}
_HARDWARE_ERRORS = {
    0x01: "input voltage",
    0x04: "overheating",
    0x08: "motor encoder",
    0x10: "electrical shock",
    0x20: "overload",
}


def drive_mode_trouble(value: int) -> str | None:
    """Why a servo with this drive mode cannot be used, or None if it can."""
    return next((trouble for bit, trouble in _DRIVE_MODE_TROUBLE.items() if value & bit), None)


def hardware_error_names(value: int) -> str:
    """The errors in a hardware error status, by name. Source: e-manual, "Shutdown (63)"."""
    names = [name for bit, name in _HARDWARE_ERRORS.items() if value & bit]
    unknown = value & ~sum(_HARDWARE_ERRORS)
    if unknown:
        names.append(f"unknown bits {unknown:#04x}")
    return ", ".join(names) or "none"
