"""Registers, models and settings of the Feetech STS series, as data.

The motor sees a duty cycle, share of the supply voltage. In position control the servo makes it of its
position error e, with P the register "P coefficient":

    duty = 0.166 P e [1/rad],    torque = stall (duty - speed / no-load speed)

Sources: Feetech, memory table of the SMS/STS series (addresses, units, sign bits, bits of the phase) and data
sheets of STS3215 (stall torque, no-load speed); the gain of the position error was measured by Rhoban ("BAM",
feetech actuator, with an oscilloscope).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Annotated, ClassVar, Final, Literal

from pydantic import Field

from palpate.robot_io.drivers.servo.joints import ServoBusSettings, ServoModel, ServoMounting
from palpate.robot_io.drivers.servo.line import Register
from palpate.robot_io.drivers.servo.stream import LARGEST_ID

# Kept without power, where they are written while the lock is 0; with the lock at 1 they hold until then.
FIRMWARE: Final = Register("firmware version", 0, 2)
MODEL_NUMBER: Final = Register("model number", 3, 2)
RETURN_DELAY: Final = Register("return delay time", 7, 1)  # 2 us
RESPONSE_LEVEL: Final = Register("response status level", 8, 1)  # 1: answers everything
MIN_POSITION: Final = Register("min position limit", 9, 2)
MAX_POSITION: Final = Register("max position limit", 11, 2)
MAX_TEMPERATURE: Final = Register("max temperature limit", 13, 1)  # degrees Celsius
MAX_VOLTAGE: Final = Register("max voltage limit", 14, 1)  # 0.1 V
MIN_VOLTAGE: Final = Register("min voltage limit", 15, 1)  # 0.1 V
PHASE: Final = Register("phase", 18, 1)  # bits that define its counting; 12 as delivered
P_GAIN: Final = Register("P coefficient", 21, 1)
D_GAIN: Final = Register("D coefficient", 22, 1)
I_GAIN: Final = Register("I coefficient", 23, 1)
STARTUP_FORCE: Final = Register("minimum startup force", 24, 2)
CW_DEAD_ZONE: Final = Register("CW dead zone", 26, 1)
CCW_DEAD_ZONE: Final = Register("CCW dead zone", 27, 1)
HOMING_OFFSET: Final = Register("homing offset", 31, 2, sign_bit=11)  # taken off the position it shows
OPERATING_MODE: Final = Register("operating mode", 33, 1)

# Lost without power.
TORQUE_ENABLE: Final = Register("torque enable", 40, 1)
ACCELERATION: Final = Register("acceleration", 41, 1)
GOAL_POSITION: Final = Register("goal position", 42, 2, sign_bit=15)
GOAL_TIME: Final = Register("goal time", 44, 2)
GOAL_SPEED: Final = Register("goal speed", 46, 2)
TORQUE_LIMIT: Final = Register("torque limit", 48, 2)  # 0.1 % of the duty cycle
LOCK: Final = Register("lock", 55, 1)
PRESENT_POSITION: Final = Register("present position", 56, 2, sign_bit=15)
PRESENT_SPEED: Final = Register("present speed", 58, 2, sign_bit=15)  # counts/s
PRESENT_LOAD: Final = Register("present load", 60, 2, sign_bit=10)  # 0.1 % of the duty cycle
PRESENT_VOLTAGE: Final = Register("present voltage", 62, 1)  # 0.1 V
PRESENT_TEMPERATURE: Final = Register("present temperature", 63, 1)  # degrees Celsius
STATUS: Final = Register("status", 65, 1)  # error bits, as in the error byte of every answer

POSITION_CONTROL: Final = 0  # operating mode
ANSWER_EVERYTHING: Final = 1
RESTARTED_LIMIT: Final = 1000  # torque limit after a restart, as delivered: what shows a restart
LARGEST_LIMIT: Final = 999  # that is set

# Bits of the phase, required value, and effect of the other value.
PHASE_BITS = (
    (2, 1, "shows speeds in steps of 50 counts/s"),
    (3, 1, "stands still at a goal speed of 0, which should mean no limit"),
    (4, 0, "counts over several turns"),
)

COUNTS_PER_REVOLUTION: Final = 4096
POSITION_STEP_RAD: Final = 2.0 * pi / COUNTS_PER_REVOLUTION
DUTY_PER_LOAD: Final = 1e-3
DUTY_PER_RAD: Final = 0.166  # times the P coefficient


@dataclass(frozen=True, slots=True)
class FeetechModel(ServoModel):
    """Data of one servo model."""

    voltage_v: float  # voltage for which the other two are stated [V]
    stall_torque_nm: float  # at the horn [N m]
    no_load_rad_s: float  # [rad/s]


_KG_CM_NM = 9.80665e-2

MODELS: Final = {
    model.name: model
    for model in (
        FeetechModel("STS3215-7.4V", 777, 7.4, 19.5 * _KG_CM_NM, pi / 3 / 0.222),
        FeetechModel("STS3215-12V", 777, 12.0, 30.0 * _KG_CM_NM, pi / 3 / 0.222),
    )
}


HomingOffset = Annotated[int, Field(ge=-2047, le=2047, strict=True)]


class FeetechServo(ServoMounting):
    """One servo; it drives the joint at its place in the list."""

    known_models: ClassVar[Mapping[str, ServoModel]] = MODELS

    homing_offset: HomingOffset | None = None

    @property
    def servo_model(self) -> FeetechModel:
        """The model's data."""
        return MODELS[self.model]


class FeetechSettings(ServoBusSettings[FeetechServo]):
    """Settings of a bus of Feetech servos."""

    baud_rate: Literal[115_200, 250_000, 500_000, 1_000_000] = 1_000_000  # as set in the servos [bit/s]
    # P coefficient of the servos' own position control: a torque is commanded as a distance from where the
    # joint is, so that with more of it torque steps are coarser, and a joint is held more stiffly.
    p_gain: Annotated[int, Field(ge=1, le=100, strict=True)] = 16
    # Ids of servos that drive no joint: they hold their positions while the torque is on.
    hold: tuple[Annotated[int, Field(ge=0, le=LARGEST_ID, strict=True)], ...] = ()

    @property
    def duty_per_rad(self) -> float:
        """Duty cycle for a position error [1/rad]."""
        return DUTY_PER_RAD * self.p_gain

    @property
    def ids(self) -> tuple[int, ...]:
        """See `ServoBusSettings.ids`; those that hold come last."""
        return (*super().ids, *self.hold)

    @property
    def labels(self) -> tuple[str, ...]:
        """See `ServoBusSettings.labels`."""
        return (*super().labels, *(f"servo {servo_id} (holds)" for servo_id in self.hold))
