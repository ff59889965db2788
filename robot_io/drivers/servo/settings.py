"""What a robot file says about the servos of one line, whoever made them."""

from collections.abc import Collection, Mapping
from typing import Annotated, ClassVar, Generic, Self, TypeVar

import numpy as np
from pydantic import Field, StrictBool, field_validator, model_validator

from palpate.robot_io.files.file_model import FileModel, Positive, ZeroAngle

_OF_EACH = frozenset(("id", "reversed", "zero_rad", "homing_offset", "second"))


class ServoMounting(FileModel):
    """How one servo sits on its joint."""

    known_models: ClassVar[Collection[str]]

    id: Annotated[int, Field(ge=0, le=252, strict=True)]  # its id on the bus
    model: str  # by its maker's name
    reversed: StrictBool = False  # whether a positive count turns the joint backwards
    # Joint angle where the servo shows position 0, whole turns aside; at half a turn, its middle position
    # 2048 is the joint's zero [rad].
    zero_rad: ZeroAngle = np.pi
    # What a calibration wrote into it, such as LeRobot's; a servo with another one is refused, for its
    # position means another angle. None takes any.
    homing_offset: Annotated[int, Field(strict=True)] | None = None
    # The other servo where two turn the joint, as a rule mirrored; what is of its model need not be repeated.
    second: Self | None = None

    @field_validator("model")
    @classmethod
    def _know_the_model(cls, name: str) -> str:
        if name not in cls.known_models:
            raise ValueError(f"is no model that is known. Valid: {', '.join(cls.known_models)}")
        return name

    @model_validator(mode="before")
    @classmethod
    def _second_is_the_same_model(cls, data: object) -> object:
        if isinstance(data, Mapping) and isinstance(data.get("second"), Mapping):
            shared = {key: data[key] for key in data.keys() & cls.model_fields.keys() - _OF_EACH}
            return {**data, "second": shared | data["second"]}
        return data

    @model_validator(mode="after")
    def _are_alike(self) -> Self:
        if self.second and self.second.second:
            raise ValueError("second: two servos on a joint at most")
        if self.second and self.second.model != self.model:
            raise ValueError(
                f"second: is a {self.second.model} beside a {self.model}; two servos on a joint must be alike"
            )
        return self

    @property
    def direction(self) -> float:
        """Sign of the joint's motion when the servo counts up."""
        return -1.0 if self.reversed else 1.0

    def homing_trouble(self, found: int) -> str | None:
        """Why a servo with this homing offset is not the one of the robot file, or None."""
        if self.homing_offset in (None, found):
            return None
        return (
            f"has a homing offset of {found}, the robot file says {self.homing_offset}: "
            "it has been calibrated anew, and its positions mean other angles"
        )


ServoType = TypeVar("ServoType", bound=ServoMounting)


class ServoBusSettings(FileModel, Generic[ServoType]):
    """A line of servos; a maker's adds what is its own."""

    # Device file; /dev/serial/by-id/... stays the same when plugs are changed.
    port: Annotated[str, Field(min_length=1)]
    baud_rate: int  # as set in the servos [bit/s]
    servos: Annotated[tuple[ServoType, ...], Field(min_length=1)]  # one for each joint, from base to tip
    # By how much the two servos of a joint may differ: the play of both, and how well their zeros are
    # known [rad].
    pair_tolerance_rad: Annotated[Positive, Field(le=0.5)] = 0.035

    @property
    def pairs(self) -> tuple[int, ...]:
        """Joints that two servos turn, from 0, from base to tip."""
        return tuple(joint for joint, servo in enumerate(self.servos) if servo.second)

    @property
    def turning(self) -> tuple[ServoType, ...]:
        """All servos that turn joints: one for each joint, then the second ones in the order of `pairs`."""
        return (*self.servos, *(servo.second for servo in self.servos if servo.second))

    @property
    def ids(self) -> tuple[int, ...]:
        """Everybody on the line; those of `turning` first."""
        return tuple(servo.id for servo in self.turning)

    @property
    def labels(self) -> tuple[str, ...]:
        """What to call them in messages, in the same order."""
        first = (f"servo {servo.id} (joint {joint})" for joint, servo in enumerate(self.servos, 1))
        second = self.turning[len(self.servos) :]
        paired = zip(self.pairs, second, strict=True)
        return (*first, *(f"servo {servo.id} (joint {joint + 1}, second)" for joint, servo in paired))

    @model_validator(mode="after")
    def _can_share_a_bus(self) -> Self:
        twice = next((servo_id for servo_id in self.ids if self.ids.count(servo_id) > 1), None)
        if twice is not None:
            raise ValueError(f"id {twice} is there twice")
        return self
