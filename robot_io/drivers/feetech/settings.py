"""What a robot file says about a Feetech bus and the servos on it."""

from collections.abc import Collection
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from robot_io.drivers.feetech.protocol import LARGEST_ID
from robot_io.drivers.feetech.tables import DUTY_PER_RAD, MODELS, ServoModel
from robot_io.drivers.servo.joints import ServoMounting
from robot_io.files.file_model import FileModel

HomingOffset = Annotated[int, Field(ge=-2047, le=2047, strict=True)]


class FeetechServo(ServoMounting):
    """One servo; it drives the joint at its place in the list."""

    known_models: ClassVar[Collection[str]] = MODELS

    # What its calibration wrote into it, such as LeRobot's; a servo with another one is refused, for its
    # position means another angle. None takes any.
    homing_offset: HomingOffset | None = None

    @property
    def servo_model(self) -> ServoModel:
        """The model's data."""
        return MODELS[self.model]


class FeetechSettings(FileModel):
    """A bus."""

    # Device file; /dev/serial/by-id/... stays the same when plugs are changed.
    port: Annotated[str, Field(min_length=1)]
    baud_rate: Literal[115_200, 250_000, 500_000, 1_000_000] = 1_000_000  # as set in the servos [bit/s]
    # P coefficient of the servos' own position control: a torque is commanded as a distance from where the
    # joint is, so that with more of it torque steps are coarser, and a joint is held more stiffly.
    p_gain: Annotated[int, Field(ge=1, le=100, strict=True)] = 16
    servos: Annotated[tuple[FeetechServo, ...], Field(min_length=1)]  # one for each joint, from base to tip
    # Ids of servos that are no joints here: they hold where they stand while the torque is on.
    hold: tuple[Annotated[int, Field(ge=0, le=LARGEST_ID, strict=True)], ...] = ()

    @property
    def duty_per_rad(self) -> float:
        """Duty cycle for a position error [1/rad]."""
        return DUTY_PER_RAD * self.p_gain

    @property
    def ids(self) -> tuple[int, ...]:
        """Everybody on the line, those that drive the joints first."""
        return (*(servo.id for servo in self.servos), *self.hold)

    @property
    def labels(self) -> tuple[str, ...]:
        """What to call them in messages, in the same order."""
        joints = (f"servo {servo.id} (joint {joint})" for joint, servo in enumerate(self.servos, 1))
        return (*joints, *(f"servo {servo_id} (holds)" for servo_id in self.hold))

    @model_validator(mode="after")
    def _can_share_a_bus(self) -> "FeetechSettings":
        twice = next((servo_id for servo_id in self.ids if self.ids.count(servo_id) > 1), None)
        if twice is not None:
            raise ValueError(f"servos and hold: id {twice} is there twice")
        return self
