"""What servos count, as joint angles, speeds and torques."""

from collections.abc import Collection, Sequence
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from pydantic import Field, StrictBool, field_validator

from robot_io.files.file_model import FileModel, ZeroAngle
from robot_io.types import FloatArray, Status

_TURN_RAD = 2.0 * np.pi


class ServoMounting(FileModel):
    """How one servo sits on the joint at its place in the list."""

    known_models: ClassVar[Collection[str]]

    id: Annotated[int, Field(ge=0, le=252, strict=True)]  # its id on the bus
    model: str  # by its maker's name
    reversed: StrictBool = False  # whether a positive count turns the joint backwards
    # Joint angle where the servo shows position 0, whole turns aside; at half a turn, its middle position
    # 2048 is the joint's zero [rad].
    zero_rad: ZeroAngle = np.pi

    @field_validator("model")
    @classmethod
    def _know_the_model(cls, name: str) -> str:
        if name not in cls.known_models:
            raise ValueError(f"is no model that is known. Valid: {', '.join(cls.known_models)}")
        return name

    @property
    def direction(self) -> float:
        """Sign of the joint's motion when the servo counts up."""
        return -1.0 if self.reversed else 1.0


class ServoSample(NamedTuple):
    """What one sync read brought; positive along the joint axes."""

    sampled_at_s: float  # when the servos were asked [s]
    position_rad: FloatArray  # shape (n,) [rad]
    velocity_rad_s: FloatArray  # as the servos derive it, shape (n,) [rad/s]
    torque_nm: FloatArray  # as the servos show it, shape (n,) [N m]
    torque_status: Status  # FAULT if a servo has a hardware error


class ServoJoints:
    """Converts what servos say.

    A servo may count over several turns, but starts within one after power-up. `choose_turns` settles which
    turn of the joint that is; from then on the angle is continuous.

    Args:
        mountings: one per joint.
        middle_rad: of each joint's range (n) [rad]; positions more than half a turn away are not told apart.
        steps: what one count is, along the joint axes, shape (3, n): of position [rad], velocity [rad/s] and
            torque [N m].
    """

    def __init__(self, mountings: Sequence[ServoMounting], middle_rad: FloatArray, steps: FloatArray) -> None:
        self._middle_rad, self.steps = middle_rad, steps
        self._zero_rad = np.array([servo.zero_rad for servo in mountings])
        self._offsets = np.zeros_like(steps)

    def choose_turns(self, counts: Sequence[Sequence[int]]) -> None:
        """Take the servos to be in the turn nearest to the middle of their joints' range."""
        self._offsets[0] = self._zero_rad
        off_rad = self._middle_rad - self.motion(counts)[0]
        self._offsets[0] += _TURN_RAD * np.round(off_rad / _TURN_RAD)

    def motion(self, counts: Sequence[Sequence[int]]) -> FloatArray:
        """Positions [rad], velocities [rad/s] and torques [N m] of counts; shape (3, n), both.

        Converted at once, as this runs in every tick.
        """
        values: FloatArray = np.array(counts, dtype=np.float64)
        values *= self.steps
        values += self._offsets
        return values

    @property
    def offset_rad(self) -> FloatArray:
        """Joint angles where the servos show 0, whole turns included (n) [rad]."""
        offset: FloatArray = self._offsets[0]
        return offset


def middle_of(low_rad: Sequence[float], high_rad: Sequence[float], count: int) -> FloatArray:
    """The middle of joint ranges, for `count` servos [rad]."""
    return np.resize(0.5 * (np.array(low_rad) + np.array(high_rad)), count)
