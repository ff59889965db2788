"""Torques of the drives along a motion, and how they depend on the base's tilt.

    torque_j = I_j(q, v, a) + G_j(q) g

I is the inertial part, and G the torque per component of the fall acceleration g in the base's axes: gravity
acts linearly. The masses are those of the URDF and taken as exact.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from control.arm.rigid_body import RigidBody
from robot_io.calibration.applied import gravity_base_m_s2
from robot_io.types import FloatArray

_UNIT = np.eye(3)


@dataclass(frozen=True)
class GravityBodies:
    """One arm without gravity, and with 1 m/s^2 along each of the base's axes."""

    weightless: RigidBody
    along: tuple[RigidBody, RigidBody, RigidBody]

    @classmethod
    def from_urdf(cls, urdf: str | Path, tip_frame: str) -> Self:
        """Build the four models of a URDF.

        Args:
            urdf: path or text.
            tip_frame: name of the tip's frame.

        Returns:
            The models.
        """
        weightless, x, y, z = (
            RigidBody.from_urdf(urdf, tip_frame, gravity) for gravity in ((0.0, 0.0, 0.0), *_UNIT)
        )
        return cls(weightless, (x, y, z))

    def parts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the inertial torques, and the torques per unit of gravity.

        Args:
            q: joint positions, shape (m, n) [rad].
            v: joint velocities, shape (m, n) [rad/s].
            a: joint accelerations, shape (m, n) [rad/s^2].

        Returns:
            I, shape (m, n) [N m], and G, shape (m, n, 3) [N m s^2/m].
        """
        rest = np.zeros_like(q)
        gravity = np.stack([body.inverse_dynamics_along(q, rest, rest) for body in self.along], axis=2)
        return self.weightless.inverse_dynamics_along(q, v, a), gravity


def fall(tilt_rad: FloatArray) -> FloatArray:
    """Compute the fall acceleration in the base's axes.

    Args:
        tilt_rad: pitch and roll, shape (2,) [rad].

    Returns:
        Shape (3,) [m/s^2].
    """
    return np.array(gravity_base_m_s2(float(tilt_rad[0]), float(tilt_rad[1])))


def fall_slopes(tilt_rad: FloatArray) -> FloatArray:
    """Compute the derivatives of `fall` by pitch and by roll.

    Args:
        tilt_rad: pitch and roll, shape (2,) [rad].

    Returns:
        Shape (3, 2) [m/s^2 per rad].
    """
    step = 1e-6
    return np.column_stack(
        [(fall(tilt_rad + step * turn) - fall(tilt_rad - step * turn)) / (2 * step) for turn in np.eye(2)]
    )


def design(bodies: GravityBodies, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Compute the columns of the linearised model: gain, Coulomb, viscous, offset of each joint; tilt.

    Args:
        bodies: models of the arm.
        q: joint positions, shape (m, n) [rad].
        v: joint velocities, shape (m, n) [rad/s].
        a: joint accelerations, shape (m, n) [rad/s^2].

    Returns:
        Shape (m n, 4 n + 2).
    """
    inertial, gravity = bodies.parts(q, v, a)
    level = np.zeros(2)
    torque = inertial + gravity @ fall(level)
    slopes = gravity @ fall_slopes(level)
    count, joints = q.shape
    columns = np.zeros((joints, count, 4 * joints + 2))
    for joint in range(joints):
        own = np.column_stack([torque[:, joint], np.sign(v[:, joint]), v[:, joint], -np.ones(count)])
        columns[joint, :, 4 * joint : 4 * joint + 4] = own
        columns[joint, :, -2:] = slopes[:, joint]
    return columns.reshape(joints * count, -1)
