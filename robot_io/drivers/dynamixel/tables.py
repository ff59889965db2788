"""Registers, models and settings of the Dynamixel X series, as data.

The addresses are the same in all models here. Values are little-endian, signed ones in two's complement.

Torque is taken as proportional to current. The constants are stall torque over stall current at the
recommended voltage, as the e-manual states them. That is approximate: by the same tables it varies by up to
12 % with the voltage, and gear friction is not in it. A calibrated constant can be given in the robot file.

Source: ROBOTIS e-manual, "Control Table" and "Specifications" of the models; "DYNAMIXEL Protocol 2.0",
Fast Sync Read (minimum firmware; XC330 is taken to be as XL330).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from math import pi
from typing import Annotated, ClassVar, Final, Literal

from pydantic import Field, model_validator

from palpate.robot_io.drivers.servo.joints import ServoBusSettings, ServoModel, ServoMounting
from palpate.robot_io.drivers.servo.line import Register
from palpate.robot_io.drivers.servo.stream import bit_names
from palpate.robot_io.files.file_model import NotNegative, Positive, TorqueConstant

# Kept without power; can be written while the torque is off.
RETURN_DELAY_TIME: Final = Register("return delay time", 9, 1)  # 2 us
DRIVE_MODE: Final = Register("drive mode", 10, 1)
OPERATING_MODE: Final = Register("operating mode", 11, 1)
SECONDARY_ID: Final = Register("secondary id", 12, 1)
HOMING_OFFSET: Final = Register("homing offset", 20, 4, signed=True)  # added to the position it shows
TEMPERATURE_LIMIT: Final = Register("temperature limit", 31, 1)  # degrees Celsius
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
NO_SECONDARY_ID: Final = 253  # and more
LARGEST_HOMING_OFFSET: Final = 1_044_479
LARGEST_RETURN_DELAY: Final = 254
LARGEST_WATCHDOG: Final = 127

DRIVE_MODE_PROBLEMS = {
    0x01: "reversed; use 'reversed: true' in the robot file instead",
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

hardware_error_names = partial(bit_names, names=_HARDWARE_ERRORS)  # source: e-manual, "Shutdown (63)"

COUNTS_PER_REVOLUTION: Final = 4096
POSITION_STEP_RAD: Final = 2.0 * pi / COUNTS_PER_REVOLUTION
VELOCITY_STEP_RAD_S: Final = 0.229 * 2.0 * pi / 60.0
WATCHDOG_FIRMWARE: Final = 38  # first firmware with a bus watchdog


@dataclass(frozen=True, slots=True)
class DynamixelModel(ServoModel):
    """Data of one servo model."""

    current_step_a: float  # unit of its currents [A]
    largest_current: int  # largest current limit, in that unit
    torque_constant_nm_a: float  # torque at the horn per current, approximate [N m/A]
    indirect_data: int  # address of the first of its indirect data
    fast_sync_read_firmware: int  # first firmware version with the fast sync read


MODELS: Final = {
    model.name: model
    for model in (
        DynamixelModel("XM430-W350", 1020, 2.69e-3, 1193, 4.1 / 2.3, 224, 45),
        DynamixelModel("XM430-W210", 1030, 2.69e-3, 1193, 3.0 / 2.3, 224, 45),
        DynamixelModel("XM540-W150", 1130, 2.69e-3, 2047, 7.3 / 4.4, 224, 45),
        DynamixelModel("XM540-W270", 1120, 2.69e-3, 2047, 10.6 / 4.4, 224, 45),
        DynamixelModel("XH540-W150", 1110, 2.69e-3, 2047, 7.1 / 4.9, 224, 45),
        DynamixelModel("XH540-W270", 1100, 2.69e-3, 2047, 9.9 / 4.9, 224, 45),
        DynamixelModel("XL330-M077", 1190, 1e-3, 1750, 0.215 / 1.47, 208, 46),
        DynamixelModel("XL330-M288", 1200, 1e-3, 1750, 0.52 / 1.47, 208, 46),
        DynamixelModel("XC330-T181", 1210, 1e-3, 910, 0.76 / 0.80, 208, 46),
        DynamixelModel("XC330-T288", 1220, 1e-3, 910, 0.92 / 0.80, 208, 46),
        DynamixelModel("XC330-M181", 1230, 1e-3, 2352, 0.60 / 1.80, 208, 46),
        DynamixelModel("XC330-M288", 1240, 1e-3, 2352, 0.93 / 1.80, 208, 46),
    )
}


class ServoSettings(ServoMounting):
    """One servo; it drives the joint at its place in the list."""

    known_models: ClassVar[Mapping[str, ServoModel]] = MODELS

    homing_offset: (
        Annotated[int, Field(ge=-LARGEST_HOMING_OFFSET, le=LARGEST_HOMING_OFFSET, strict=True)] | None
    ) = None
    torque_constant_nm_a: TorqueConstant | None = None  # instead of the model's own [N m/A]

    @property
    def servo_model(self) -> DynamixelModel:
        """The model's data."""
        return MODELS[self.model]


class DynamixelSettings(ServoBusSettings[ServoSettings]):
    """Settings of a bus of Dynamixel servos."""

    # As set in the servos [bit/s].
    baud_rate: Literal[57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000] = 4_000_000
    # How long a servo waits before it answers, in steps of 2 us [s].
    return_delay_s: Annotated[NotNegative, Field(le=LARGEST_RETURN_DELAY * RETURN_DELAY_STEP_S)] = 0.0
    # Silence after which a servo switches its torque off, in steps of 20 ms [s].
    watchdog_s: Annotated[Positive, Field(ge=WATCHDOG_STEP_S, le=LARGEST_WATCHDOG * WATCHDOG_STEP_S)] = 0.06
    fast_sync_read: bool = True  # used if the firmware of all servos has it

    @property
    def watchdog(self) -> int:
        """Value in the servo's unit."""
        return max(1, round(self.watchdog_s / WATCHDOG_STEP_S))

    @model_validator(mode="after")
    def _check_models_fit_together(self) -> "DynamixelSettings":
        if len({servo.servo_model.indirect_data for servo in self.servos}) > 1:
            raise ValueError("servos: X330 and larger models use different addresses: use two buses")
        return self
