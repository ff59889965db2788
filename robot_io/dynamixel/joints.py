"""The edge between counts and SI units: joint angles, velocities and torques of the servos on one bus."""

from collections.abc import Sequence

import numpy as np

from robot_io.dynamixel.feedback import Feedback
from robot_io.dynamixel.models import POSITION_STEP_RAD, VELOCITY_STEP_RAD_S
from robot_io.dynamixel.settings import ServoSettings
from robot_io.types import FloatArray, IntArray

_TURN_RAD = 2.0 * np.pi


class ServoJoints:
    """Converts what servos say and are told.

    A servo counts over several turns, but starts within one after power-up. `choose_turns` settles which turn
    of the joint that is; from then on the angle is continuous.

    Args:
        servos: one per joint.
        middle_rad: of each joint's range (n) [rad]; positions more than half a turn away are not told apart.

    Attributes:
        torque_step_nm: torque of one count of current (n), positive [N m].
    """

    def __init__(self, servos: Sequence[ServoSettings], middle_rad: Sequence[float]) -> None:
        self._middle_rad = np.array(middle_rad)
        self._zero_rad = np.array([servo.zero_rad for servo in servos])
        direction = np.array([-1.0 if servo.reversed else 1.0 for servo in servos])
        self.torque_step_nm = np.array(
            [
                (servo.torque_constant_nm_a or servo.servo_model.torque_constant_nm_a)
                * servo.servo_model.current_step_a
                for servo in servos
            ]
        )
        self._position_step_rad = direction * POSITION_STEP_RAD
        self._velocity_step_rad_s = direction * VELOCITY_STEP_RAD_S
        self._signed_torque_step_nm = direction * self.torque_step_nm
        self._turns_rad = np.zeros(len(servos))

    def choose_turns(self, feedback: Sequence[Feedback]) -> None:
        """Take the servos to be in the turn nearest to the middle of their joints' range."""
        self._turns_rad = np.zeros_like(self._turns_rad)
        off_rad = self._middle_rad - self.position_rad(feedback)
        self._turns_rad = _TURN_RAD * np.round(off_rad / _TURN_RAD)

    def position_rad(self, feedback: Sequence[Feedback]) -> FloatArray:
        """Joint angles (n) [rad]."""
        counts = np.array([servo.position for servo in feedback], dtype=np.float64)
        position: FloatArray = self._zero_rad + self._turns_rad + counts * self._position_step_rad
        return position

    def velocity_rad_s(self, feedback: Sequence[Feedback]) -> FloatArray:
        """Joint velocities as the servos derive them (n) [rad/s]."""
        counts = np.array([servo.velocity for servo in feedback], dtype=np.float64)
        velocity: FloatArray = counts * self._velocity_step_rad_s
        return velocity

    def torque_nm(self, feedback: Sequence[Feedback]) -> FloatArray:
        """Joint torques by the motor currents (n), positive along the joint axis [N m]."""
        counts = np.array([servo.current for servo in feedback], dtype=np.float64)
        torque: FloatArray = counts * self._signed_torque_step_nm
        return torque

    def current_counts(self, torque_nm: FloatArray, largest: IntArray) -> IntArray:
        """Goal currents (n) for joint torques (n) [N m], cut at the `largest` counts (n)."""
        counts = np.rint(torque_nm / self._signed_torque_step_nm)
        limited: IntArray = np.minimum(np.maximum(counts, -largest), largest).astype(np.int64)
        return limited

    def torque_of_counts(self, counts: IntArray) -> FloatArray:
        """The joint torques (n) [N m] of goal currents (n)."""
        torque: FloatArray = counts * self._signed_torque_step_nm
        return torque
