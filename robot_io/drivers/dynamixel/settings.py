"""What a robot file says about a Dynamixel bus and the servos on it."""

from collections.abc import Collection
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from palpate.robot_io.drivers.dynamixel.tables import (
    LARGEST_HOMING_OFFSET,
    LARGEST_RETURN_DELAY,
    LARGEST_WATCHDOG,
    MODELS,
    RETURN_DELAY_STEP_S,
    WATCHDOG_STEP_S,
    DynamixelModel,
)
from palpate.robot_io.drivers.servo.settings import ServoBusSettings, ServoMounting
from palpate.robot_io.files.file_model import NotNegative, Positive, TorqueConstant


class ServoSettings(ServoMounting):
    """One servo; it drives the joint at its place in the list."""

    known_models: ClassVar[Collection[str]] = MODELS

    homing_offset: (
        Annotated[int, Field(ge=-LARGEST_HOMING_OFFSET, le=LARGEST_HOMING_OFFSET, strict=True)] | None
    ) = None
    torque_constant_nm_a: TorqueConstant | None = None  # instead of the model's own [N m/A]

    @property
    def servo_model(self) -> DynamixelModel:
        """The model's data."""
        return MODELS[self.model]


class DynamixelSettings(ServoBusSettings[ServoSettings]):
    """A bus."""

    # As set in the servos [bit/s].
    baud_rate: Literal[57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000] = 4_000_000
    # How long a servo waits before it answers, in steps of 2 us [s].
    return_delay_s: Annotated[NotNegative, Field(le=LARGEST_RETURN_DELAY * RETURN_DELAY_STEP_S)] = 0.0
    # A servo that hears nothing for so long lets go, in steps of 20 ms [s].
    watchdog_s: Annotated[Positive, Field(ge=WATCHDOG_STEP_S, le=LARGEST_WATCHDOG * WATCHDOG_STEP_S)] = 0.06
    fast_sync_read: bool = True  # use it if the firmware of all servos knows it

    @property
    def return_delay(self) -> int:
        """In the servo's unit."""
        return round(self.return_delay_s / RETURN_DELAY_STEP_S)

    @property
    def watchdog(self) -> int:
        """In the servo's unit."""
        return max(1, round(self.watchdog_s / WATCHDOG_STEP_S))

    @model_validator(mode="after")
    def _keep_their_data_alike(self) -> "DynamixelSettings":
        if len({servo.servo_model.indirect_data for servo in self.servos}) > 1:
            raise ValueError("servos: X330 and larger models keep their data elsewhere, and need two buses")
        return self
