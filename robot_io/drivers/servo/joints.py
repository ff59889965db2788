"""Settings of servos, and conversion of their counts to joint angles, speeds and torques, also for pairs.

Two servos of a joint must have equal angles, and their torques add. Each servo of a pair gets half of the
joint's torque. If their angles differ, a horn has slipped, a position sensor is wrong, or the robot file is;
the joint's position is then unknown. If their torques differ for the tolerated time of an unresponsive drive,
one of them has lost its torque or works against the other, which their sum would not always show.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, ClassVar, Generic, Self, TypeVar

import numpy as np
from pydantic import Field, StrictBool, field_validator, model_validator

from palpate.robot_io.errors import DeviceError
from palpate.robot_io.examination import Finding, fail, ok
from palpate.robot_io.files.file_model import FileModel, Positive, ZeroAngle
from palpate.robot_io.guard.limits import Limits
from palpate.robot_io.types import FloatArray

_KEYS_OF_EACH_SERVO = frozenset(("id", "reversed", "zero_rad", "homing_offset", "second"))


@dataclass(frozen=True, slots=True)
class ServoModel:
    """Data of one servo model."""

    name: str  # as printed on it, or as sold
    number: int  # model number in its answers; some models share one


class ServoMounting(FileModel):
    """Mounting of one servo on its joint."""

    known_models: ClassVar[Mapping[str, ServoModel]]

    id: Annotated[int, Field(ge=0, le=252, strict=True)]  # its id on the bus
    model: str  # by its maker's name
    reversed: StrictBool = False  # whether a positive count turns the joint backwards
    # Joint angle at the servo's position 0, except for whole turns; at half a turn, its middle position 2048
    # is the joint's zero [rad].
    zero_rad: ZeroAngle = np.pi
    # Offset that a calibration wrote into the servo, such as LeRobot's [counts]. A servo with another offset
    # is refused, because its positions mean other angles. None accepts any.
    homing_offset: Annotated[int, Field(strict=True)] | None = None
    # The other servo if two turn the joint, usually mirrored; its model's settings need not be repeated.
    second: Self | None = None

    @field_validator("model")
    @classmethod
    def _check_model(cls, name: str) -> str:
        if name not in cls.known_models:
            raise ValueError(f"is not a known model. Valid: {', '.join(cls.known_models)}")
        return name

    @model_validator(mode="before")
    @classmethod
    def _fill_second_servo(cls, data: object) -> object:
        if isinstance(data, Mapping) and isinstance(data.get("second"), Mapping):
            shared = {key: data[key] for key in data.keys() & cls.model_fields.keys() - _KEYS_OF_EACH_SERVO}
            return {**data, "second": shared | data["second"]}
        return data

    @model_validator(mode="after")
    def _check_second_servo(self) -> Self:
        if self.second and self.second.second:
            raise ValueError("second: a joint can have at most two servos")
        if self.second and self.second.model != self.model:
            raise ValueError(
                f"second: model {self.second.model} differs from {self.model}; two servos on a joint "
                "must have one model"
            )
        return self

    @property
    def direction(self) -> float:
        """Sign of the joint's motion when the servo counts up."""
        return -1.0 if self.reversed else 1.0

    @classmethod
    def name_model(cls, number: int) -> str:
        """Return the name of a model number, for messages.

        Args:
            number: model number in the answer of the servo.
        """
        names = [model.name for model in cls.known_models.values() if model.number == number]
        return " or ".join(names) or f"model number {number}"

    def refuse_other_model(self, number: int) -> None:
        """Raise a `DeviceError` if the model number of a servo is not that of this model.

        Args:
            number: model number in the answer of the servo.
        """
        if number != self.known_models[self.model].number:
            found = self.name_model(number)
            raise DeviceError(f"servo {self.id} is a {found}, but the robot file states {self.model}")

    def homing_problem(self, measured_offset: int) -> str | None:
        """Return why a servo is not the servo of the robot file; None if it may be.

        Args:
            measured_offset: homing offset that the servo has [counts].
        """
        if self.homing_offset in (None, measured_offset):
            return None
        return (
            f"has a homing offset of {measured_offset}, but the robot file states {self.homing_offset}, so "
            "the servo has been calibrated again, and its positions mean other angles now"
        )


ServoType = TypeVar("ServoType", bound=ServoMounting)


class ServoBusSettings(FileModel, Generic[ServoType]):
    """Settings of a line of servos; base of each maker's settings."""

    # Device file; /dev/serial/by-id/... stays the same when plugs are changed.
    port: Annotated[str, Field(min_length=1)]
    baud_rate: int  # as set in the servos [bit/s]
    servos: Annotated[tuple[ServoType, ...], Field(min_length=1)]  # one for each joint, from base to tip
    # Largest difference between the two servos of a joint: the play of both, and the error of their
    # zeros [rad].
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
        """All servos on the line; those of `turning` first."""
        return tuple(servo.id for servo in self.turning)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the servos in messages, in the same order."""
        first = (f"servo {servo.id} (joint {joint})" for joint, servo in enumerate(self.servos, 1))
        paired = zip(self.pairs, self.turning[len(self.servos) :], strict=True)
        return (*first, *(f"servo {servo.id} (joint {joint + 1}, second)" for joint, servo in paired))

    @model_validator(mode="after")
    def _check_servo_ids(self) -> Self:
        twice = next((servo_id for servo_id in self.ids if self.ids.count(servo_id) > 1), None)
        if twice is not None:
            raise ValueError(f"id {twice} appears twice")
        return self


# Largest difference between the torques of two servos: this share of the larger torque,
_DIFFERENT_SHARE = 0.5
_FLOOR_SHARE = 0.03  # plus this share of the joint's torque limit
_SAMPLES = 5  # consecutive samples with a larger difference before it counts, at any sample rate


class ServoPairs:
    """Conversion between values of servos and of joints with one or two servos.

    Servos are in the order of `ServoBusSettings.turning`: n joints have m servos, of which the last m - n are
    the second ones.

    Attributes:
        joint_count: Number of joints n.
        joints: Joints that two servos turn, m - n of them.
    """

    def __init__(self, settings: ServoBusSettings[Any], limits: Limits) -> None:
        self.joint_count = len(settings.servos)
        self.joints = list(settings.pairs)
        self._labels = [
            f"servos {settings.ids[joint]} and {settings.ids[self.joint_count + k]} (joint {joint + 1})"
            for k, joint in enumerate(self.joints)
        ]
        self._tolerance_rad = settings.pair_tolerance_rad
        self._second_zeros_rad = [servo.zero_rad for servo in settings.turning[self.joint_count :]]
        in_pair = [0.5 if joint in self.joints else 1.0 for joint in range(self.joint_count)]
        self._share = self.repeat_for_servos(in_pair)
        self._floor_nm = [_FLOOR_SHARE * limits.torque_nm[joint] for joint in self.joints]
        self._time_s = limits.unresponsive_drive_s
        self.restart()

    def restart(self) -> None:
        """Reset the time since torques differ."""
        self._alike_at_s, self._count = [inf] * len(self.joints), [0] * len(self.joints)

    def repeat_for_servos(self, joint_values: Sequence[float]) -> list[float]:
        """Repeat a value of each joint, such as a limit, for each servo, shape (m,).

        Args:
            joint_values: values of the joints, shape (n,).
        """
        return [*joint_values, *(joint_values[joint] for joint in self.joints)]

    def split_torques(self, torque_nm: Sequence[float]) -> Sequence[float]:
        """Divide torques of joints among servos, shape (m,) [N m].

        Args:
            torque_nm: torque of the joints, shape (n,) [N m].
        """
        if not self.joints:
            return torque_nm
        return [
            torque * share
            for torque, share in zip(self.repeat_for_servos(torque_nm), self._share, strict=True)
        ]

    def limit_to_weaker(self, largest_nm: Sequence[float]) -> list[float]:
        """Limit both servos of a pair to what the weaker one can exert, shape (m,) [N m].

        Args:
            largest_nm: Largest torque of each servo (m) [N m].
        """
        weaker_nm = list(largest_nm[: self.joint_count])
        for joint, second_nm in zip(self.joints, largest_nm[self.joint_count :], strict=True):
            weaker_nm[joint] = min(weaker_nm[joint], second_nm)
        return self.repeat_for_servos(weaker_nm)

    def sum_pairs(self, servo_states: Sequence[float]) -> Sequence[float]:
        """Add the values of the two servos of a pair, such as torques; shape (n,).

        Args:
            servo_states: shape (m,).
        """
        if not self.joints:
            return servo_states
        joint_values = list(servo_states[: self.joint_count])
        for joint, second in zip(self.joints, servo_states[self.joint_count :], strict=True):
            joint_values[joint] += second
        return joint_values

    def join_pairs(self, motion: FloatArray) -> FloatArray:
        """Average the positions and velocities of pairs, and add their torques; shape (3, n).

        Args:
            motion: positions [rad], velocities [rad/s] and torques [N m] of the servos, shape (3, m).
        """
        joined: FloatArray = np.array([self.sum_pairs(row) for row in motion.tolist()])
        joined[:2] *= self._share[: self.joint_count]
        return joined

    def _ahead_rad(self, position_rad: FloatArray) -> list[float]:
        """Return the angle of each pair's second servo minus that of its first, shape (m - n,) [rad]."""
        ahead: list[float] = (position_rad[self.joint_count :] - position_rad[self.joints]).tolist()
        return ahead

    def examine(self, position_rad: FloatArray) -> list[Finding]:
        """Compare the two servos of each pair; a remedy states the second zero that would align them.

        Args:
            position_rad: Positions of all servos (m) [rad].
        """
        findings = []
        ahead_rad = self._ahead_rad(position_rad)
        for label, ahead, zero_rad in zip(self._labels, ahead_rad, self._second_zeros_rad, strict=True):
            value = f"stand {abs(ahead):.4f} rad apart; pair_tolerance_rad is {self._tolerance_rad:g}"
            agreeing_rad = zero_rad - ahead
            remedy = (
                "check horns and 'reversed'; if they are right, "
                f"set the second servo's zero_rad to {agreeing_rad:.4f}"
            )
            agree = abs(ahead) <= self._tolerance_rad
            findings.append(ok(label, value) if agree else fail(label, value, remedy))
        return findings

    def disagreement(self, position_rad: FloatArray) -> str | None:
        """Describe a pair of servos whose angles disagree; None if all agree.

        Args:
            position_rad: Positions of all servos (m) [rad].
        """
        for label, ahead_rad in zip(self._labels, self._ahead_rad(position_rad), strict=True):
            if not abs(ahead_rad) <= self._tolerance_rad:
                return (
                    f"{label} stand {abs(ahead_rad):.3f} rad apart, but pair_tolerance_rad is "
                    f"{self._tolerance_rad:g}; has a horn slipped, or is zero_rad or reversed wrong?"
                )
        return None

    def torque_difference(self, torque_nm: FloatArray, time_s: float) -> str | None:
        """Describe a pair whose torques have differed for `unresponsive_drive_s`; None without one.

        Args:
            torque_nm: Measured torques of all servos (m) [N m].
            time_s: When they were measured [s].
        """
        for k, joint in enumerate(self.joints):
            first_nm, second_nm = float(torque_nm[joint]), float(torque_nm[self.joint_count + k])
            larger_nm = max(abs(first_nm), abs(second_nm))
            if abs(first_nm - second_nm) <= _DIFFERENT_SHARE * larger_nm + self._floor_nm[k]:
                self._alike_at_s[k], self._count[k] = time_s, 0
                continue
            self._alike_at_s[k] = min(self._alike_at_s[k], time_s)
            self._count[k] += 1
            if self._count[k] >= _SAMPLES and time_s - self._alike_at_s[k] >= self._time_s - 1e-9:
                return (
                    f"{self._labels[k]} exert {first_nm:.2f} and {second_nm:.2f} N m, although both "
                    "were sent the same torque; one has lost its torque, or works against the other"
                )
        return None


_TURN_RAD = 2.0 * np.pi


class ServoJoints:
    """Converts counts of servos to joint values.

    A servo may count over several turns, but starts within one after power-up. `choose_turns` determines the
    joint's turn; from then on the angle is continuous. Positions more than half a turn from the middle of a
    joint's range are ambiguous.

    Args:
        middle_rad: Middle of each joint's range (n) [rad].
        steps: Size of one count of each servo along the joint axes, shape (3, m): position [rad], velocity
            [rad/s] and torque [N m].
    """

    def __init__(
        self,
        mountings: Sequence[ServoMounting],
        pairs: ServoPairs,
        middle_rad: Sequence[float],
        steps: FloatArray,
    ) -> None:
        self._pairs, self.steps = pairs, steps
        self._middle_rad = np.array(pairs.repeat_for_servos(middle_rad))
        self._zero_rad = np.array([servo.zero_rad for servo in mountings])
        self._offsets = np.zeros_like(steps)  # joint angles at the servos' position 0, with whole turns

    def choose_turns(self, counts: Sequence[Sequence[float]]) -> None:
        """Choose for each servo the turn that is nearest to the middle of its joint's range.

        For the second servo of a joint, it is the turn that is nearest to the first servo.

        Args:
            counts: Counts of position, velocity and torque, shape (3, m).
        """
        self._offsets[0] = self._zero_rad
        shown_rad = self.motion(counts)[0]
        turned_rad = shown_rad + _whole_turns(self._middle_rad - shown_rad)
        first_rad = np.array(self._pairs.repeat_for_servos(turned_rad[: self._pairs.joint_count]))
        self._offsets[0] += _whole_turns(first_rad - shown_rad)

    def motion(self, counts: Sequence[Sequence[float]]) -> FloatArray:
        """Convert counts to positions [rad], speeds [rad/s] and torques [N m] along the joint axes.

        Args:
            counts: Counts of position, velocity and torque of m servos, shape (3, m).

        Returns:
            Shape (3, m).
        """
        motion: FloatArray = np.array(counts, dtype=np.float64)
        motion *= self.steps
        motion += self._offsets
        return motion


def _whole_turns(angle_rad: FloatArray) -> FloatArray:
    """Return the angles rounded to whole turns [rad]."""
    turns: FloatArray = _TURN_RAD * np.round(angle_rad / _TURN_RAD)
    return turns
