"""What servos count, as joint angles, speeds and torques."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from palpate.robot_io.drivers.servo.pairs import ServoPairs
from palpate.robot_io.drivers.servo.settings import ServoMounting
from palpate.robot_io.types import FloatArray

_TURN_RAD = 2.0 * np.pi


class ServoSample(NamedTuple):
    """What one sync read brought; positive along the joint axes."""

    sampled_at_s: float  # when the servos were asked [s]
    position_rad: FloatArray  # shape (n,) [rad]
    velocity_rad_s: FloatArray  # as the servos derive it, shape (n,) [rad/s]
    torque_nm: FloatArray  # as the servos show it, shape (n,) [N m]
    # Position, velocity and torque of every servo, in the order of `ServoBusSettings.turning`; shape (3, m).
    of_servos: FloatArray


class ServoJoints:
    """Converts what servos say.

    A servo may count over several turns, but starts within one after power-up. `choose_turns` settles which
    turn of the joint that is; from then on the angle is continuous. Positions more than half a turn away from
    the middle of a joint's range are not told apart.

    Args:
        mountings: How the servos that turn joints sit on them (m).
        pairs: Which of them turn a joint together.
        middle_rad: Middle of each joint's range (n) [rad].
        steps: What one count of each servo is along the joint axes, shape (3, m): position [rad], velocity
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
        self._middle_rad = np.array(pairs.of_servos(middle_rad))
        self._zero_rad = np.array([servo.zero_rad for servo in mountings])
        self._offsets = np.zeros_like(steps)

    def choose_turns(self, counts: Sequence[Sequence[int]]) -> None:
        """Take the servos to be in the turn nearest to the middle of their joints' range.

        The second servo of a joint is in the turn that is nearest to the first.

        Args:
            counts: Counts of position, velocity and torque, shape (3, m).
        """
        self._offsets[0] = self._zero_rad
        shown_rad = self.motion(counts)[0]
        turned_rad = shown_rad + _whole_turns(self._middle_rad - shown_rad)
        first_rad = np.array(self._pairs.of_servos(turned_rad[: self._pairs.joint_count]))
        self._offsets[0] += _whole_turns(first_rad - shown_rad)

    def motion(self, counts: Sequence[Sequence[int]]) -> FloatArray:
        """Convert counts; all at once, as this runs in every tick.

        Args:
            counts: Counts of position, velocity and torque, shape (3, m).

        Returns:
            Positions [rad], velocities [rad/s] and torques [N m] along the joint axes, shape (3, m).
        """
        values: FloatArray = np.array(counts, dtype=np.float64)
        values *= self.steps
        values += self._offsets
        return values

    @property
    def offset_rad(self) -> FloatArray:
        """Joint angles where the servos show 0, whole turns included (m) [rad]."""
        offset: FloatArray = self._offsets[0]
        return offset


def _whole_turns(angle_rad: FloatArray) -> FloatArray:
    """The whole turns nearest to angles [rad]."""
    turns: FloatArray = _TURN_RAD * np.round(angle_rad / _TURN_RAD)
    return turns
