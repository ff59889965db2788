"""Joints that two servos turn together: both must stand alike and pull alike, and their torques add.

Each servo of a pair is sent half of the joint's torque. Where they stand apart, a horn has slipped, a
position sensor is wrong, or the robot file is; nobody knows then where the joint is. Where what they exert
differs for as long as a deaf drive is borne, one of them has lost its torque or works against the other:
their sum would not always tell.
"""

from math import inf
from typing import Any

import numpy as np

from robot_io.drivers.servo.settings import ServoBusSettings
from robot_io.examination import Finding, fail, ok
from robot_io.guard.limits import Limits
from robot_io.types import FloatArray

_DIFFERENT_SHARE = 0.5  # of the larger of the two torques, and
_FLOOR_SHARE = 0.03  # of the joint's torque limit, may be between them
_SAMPLES = 5  # in a row before it counts, however slowly they come


class ServoPairs:
    """Makes joints of servos, and servos of joints; servos are in the order of `ServoBusSettings.turning`."""

    def __init__(self, settings: ServoBusSettings[Any], limits: Limits) -> None:
        self.joint_count = len(settings.servos)
        self._joints = list(settings.pairs)
        self._labels = [
            f"servos {settings.ids[joint]} and {settings.ids[self.joint_count + k]} (joint {joint + 1})"
            for k, joint in enumerate(self._joints)
        ]
        self._tolerance_rad = settings.pair_tolerance_rad
        self._second_zeros_rad = [servo.zero_rad for servo in settings.turning[self.joint_count :]]
        self._share = np.ones(self.joint_count + len(self._joints))
        self._share[self._joints] = self._share[self.joint_count :] = 0.5
        self._floor_nm = _FLOOR_SHARE * np.resize(limits.torque_nm, self.joint_count)[self._joints]
        self._time_s = limits.deaf_drive_s
        self.restart()

    def restart(self) -> None:
        """Forget since when torques differ."""
        self._alike_at_s, self._count = [inf] * len(self._joints), [0] * len(self._joints)

    def of_servos(self, of_joints: FloatArray) -> FloatArray:
        """A value of each joint (n), such as a limit, for each servo (m)."""
        return np.concatenate((of_joints, of_joints[self._joints])) if self._joints else of_joints

    def shares(self, torque_nm: FloatArray) -> FloatArray:
        """What each servo is to exert (m) for torques of joints (n) [N m]."""
        return self.of_servos(torque_nm) * self._share if self._joints else torque_nm

    def weaker(self, largest_nm: FloatArray) -> FloatArray:
        """What each servo may exert (m) where the two of a pair are to exert the same, of what it can (m)."""
        weaker_nm = largest_nm[: self.joint_count].copy()
        weaker_nm[self._joints] = np.minimum(weaker_nm[self._joints], largest_nm[self.joint_count :])
        return self.of_servos(weaker_nm)

    def summed(self, torque_nm: FloatArray) -> FloatArray:
        """Torques of joints (n) of those of servos (m) [N m]."""
        if not self._joints:
            return torque_nm
        of_joints = torque_nm[: self.joint_count].copy()
        of_joints[self._joints] += torque_nm[self.joint_count :]
        return of_joints

    def joined(self, motion: FloatArray) -> FloatArray:
        """Positions, velocities and torques of joints (3, n) of those of servos (3, m): means and sums."""
        if not self._joints:
            return motion
        position, velocity, torque_nm = (self.summed(row) for row in motion)
        return np.array((self._mean(position), self._mean(velocity), torque_nm))

    def _mean(self, summed: FloatArray) -> FloatArray:
        return summed * self._share[: self.joint_count]

    def _ahead_rad(self, position_rad: FloatArray) -> list[float]:
        """By how much the second servo of each pair stands ahead of the first [rad]."""
        ahead: list[float] = (position_rad[self.joint_count :] - position_rad[self._joints]).tolist()
        return ahead

    def examine(self, position_rad: FloatArray) -> list[Finding]:
        """How far the servos of each pair stand apart by the positions of all servos (m) [rad]."""
        ahead_rad = self._ahead_rad(position_rad)
        return list(map(self._finding, self._labels, ahead_rad, self._second_zeros_rad))

    def _finding(self, label: str, ahead_rad: float, zero_rad: float) -> Finding:
        value = f"stand {abs(ahead_rad):.4f} rad apart, pair_tolerance_rad is {self._tolerance_rad:g}"
        if abs(ahead_rad) <= self._tolerance_rad:
            return ok(label, value)
        right_rad = zero_rad - ahead_rad
        remedy = f"check horns and 'reversed'; if they are right, zero_rad of the second is {right_rad:.4f}"
        return fail(label, value, remedy)

    def disagreement(self, position_rad: FloatArray) -> str | None:
        """Which pair does not stand alike by the positions of all servos (m) [rad], or None."""
        if not self._joints:
            return None
        for label, ahead_rad in zip(self._labels, self._ahead_rad(position_rad), strict=True):
            if not abs(ahead_rad) <= self._tolerance_rad:
                return (
                    f"{label} stand {abs(ahead_rad):.3f} rad apart, pair_tolerance_rad is "
                    f"{self._tolerance_rad:g}: has a horn slipped, or is zero_rad or reversed wrong?"
                )
        return None

    def strife(self, torque_nm: FloatArray, time_s: float) -> str | None:
        """Which pair has not pulled alike for so long, or None.

        By the torques of all servos (m) [N m] as they were measured at `time_s` [s].
        """
        for k, joint in enumerate(self._joints):
            first_nm, second_nm = float(torque_nm[joint]), float(torque_nm[self.joint_count + k])
            larger_nm = max(abs(first_nm), abs(second_nm))
            if abs(first_nm - second_nm) <= _DIFFERENT_SHARE * larger_nm + self._floor_nm[k]:
                self._alike_at_s[k], self._count[k] = time_s, 0
                continue
            self._alike_at_s[k] = min(self._alike_at_s[k], time_s)
            self._count[k] += 1
            if self._count[k] >= _SAMPLES and time_s - self._alike_at_s[k] >= self._time_s - 1e-9:
                return (
                    f"{self._labels[k]} exert {first_nm:.2f} and {second_nm:.2f} N m where each was sent the "
                    "same: one has lost its torque, or works against the other"
                )
        return None
