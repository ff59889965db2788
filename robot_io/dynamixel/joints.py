"""The edge between counts and SI units: joint angles, velocities and torques of the servos on one bus."""

from collections.abc import Sequence

import numpy as np

from robot_io.dynamixel.feedback import Feedback
from robot_io.dynamixel.models import POSITION_STEP_RAD, VELOCITY_STEP_RAD_S
from robot_io.dynamixel.settings import ServoSettings
from robot_io.types import FloatArray

_TURN_RAD = 2.0 * np.pi


class ServoJoints:
    """Converts what servos say and are told.

    A servo counts over several turns, but starts within one after power-up. `choose_turns` settles which turn
    of the joint that is; from then on the angle is continuous.

    Args:
        servos: one per joint.
        middle_rad: of each joint's range (n) [rad]; positions more than half a turn away are not told apart.
    """

    def __init__(self, servos: Sequence[ServoSettings], middle_rad: Sequence[float]) -> None:
        self._middle_rad = np.array(middle_rad)
        self._zero_rad = np.array([servo.zero_rad for servo in servos])
        direction = np.array([-1.0 if servo.reversed else 1.0 for servo in servos])
        torque_step_nm = np.array(
            [
                (servo.torque_constant_nm_a or servo.servo_model.torque_constant_nm_a)
                * servo.servo_model.current_step_a
                for servo in servos
            ]
        )
        steps = (
            direction * POSITION_STEP_RAD,
            direction * VELOCITY_STEP_RAD_S,
            direction * torque_step_nm,
        )
        self._steps = np.array(steps)  # (3, n): of position, velocity and torque
        self._offsets = np.zeros_like(self._steps)
        self._torque_steps_nm: list[float] = self._steps[2].tolist()

    def choose_turns(self, feedback: Sequence[Feedback]) -> None:
        """Take the servos to be in the turn nearest to the middle of their joints' range."""
        self._offsets[0] = self._zero_rad
        off_rad = self._middle_rad - self.motion(feedback)[0]
        self._offsets[0] += _TURN_RAD * np.round(off_rad / _TURN_RAD)

    def motion(self, feedback: Sequence[Feedback]) -> FloatArray:
        """Positions [rad], velocities [rad/s] by the servos, torques [N m] by the currents, shape (3, n).

        All are positive along the joint axes; converted at once, as this runs in every tick.
        """
        _, _, _, current, velocity, position, _ = zip(*feedback, strict=True)
        values: FloatArray = np.array((position, velocity, current), dtype=np.float64)
        values *= self._steps
        values += self._offsets
        return values

    def current_counts(self, torque_nm: FloatArray, largest: Sequence[int]) -> list[int]:
        """Goal currents (n) for joint torques (n) [N m], cut at the `largest` counts (n)."""
        return [
            min(max(round(torque / step), -most), most)
            for torque, step, most in zip(torque_nm.tolist(), self._torque_steps_nm, largest, strict=True)
        ]

    def torque_of_counts(self, counts: Sequence[int]) -> FloatArray:
        """The joint torques (n) [N m] of goal currents (n)."""
        torque: FloatArray = counts * self._steps[2]
        return torque
