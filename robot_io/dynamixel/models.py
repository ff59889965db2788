"""The servos that can be used, as data.

Torque is taken to be proportional to current. The constants are stall torque over stall current at the
recommended voltage, as the e-manual's specifications state them. That is approximate: by the same tables it
varies by up to 12 % with the voltage, and friction in the gears, which takes from a moving servo's torque or
adds to it, is not in it. A calibrated constant can be given in the robot file.

Source: ROBOTIS e-manual, pages of the five models: "Specifications" (stall torque), "Control Table" (model
number, unit and range of Goal Current and Current Limit, Indirect Data 1, units of velocity and position);
"DYNAMIXEL Protocol 2.0", Fast Sync Read (from which firmware on).
"""

from dataclasses import dataclass
from math import pi
from typing import Final

COUNTS_PER_REVOLUTION: Final = 4096
POSITION_STEP_RAD: Final = 2.0 * pi / COUNTS_PER_REVOLUTION
VELOCITY_STEP_RAD_S: Final = 0.229 * 2.0 * pi / 60.0
WATCHDOG_FIRMWARE: Final = 38  # the bus watchdog exists from here on


@dataclass(frozen=True, slots=True)
class ServoModel:
    """One model.

    Attributes:
        name: as printed on it.
        number: model number.
        current_step_a: unit of its currents [A].
        largest_current: largest current limit, in that unit.
        torque_constant_nm_a: torque at the horn per current, approximate [N m/A].
        indirect_data: address of the first of its indirect data.
        fast_sync_read_firmware: it knows the fast sync read from this firmware on.
    """

    name: str
    number: int
    current_step_a: float
    largest_current: int
    torque_constant_nm_a: float
    indirect_data: int
    fast_sync_read_firmware: int


MODELS: Final = {
    model.name: model
    for model in (
        ServoModel("XM430-W350", 1020, 2.69e-3, 1193, 4.1 / 2.3, 224, 45),
        ServoModel("XM540-W270", 1120, 2.69e-3, 2047, 10.6 / 4.4, 224, 45),
        ServoModel("XH540-W270", 1100, 2.69e-3, 2047, 9.9 / 4.9, 224, 45),
        ServoModel("XL330-M077", 1190, 1e-3, 1750, 0.215 / 1.47, 208, 46),
        ServoModel("XL330-M288", 1200, 1e-3, 1750, 0.52 / 1.47, 208, 46),
    )
}


def model_name(number: int) -> str:
    """What a model number means, for messages."""
    return next((model.name for model in MODELS.values() if model.number == number), f"model number {number}")
