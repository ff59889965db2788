"""What the drives must exert along a motion, as far as it is known, and how that depends on the tilt.

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
        """The arm of a URDF (path or text)."""
        weightless, x, y, z = (
            RigidBody.from_urdf(urdf, tip_frame, gravity) for gravity in ((0.0, 0.0, 0.0), *_UNIT)
        )
        return cls(weightless, (x, y, z))

    def parts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
        """I, shape (m, n), and G, shape (m, n, 3), along motions of shape (m, n)."""
        rest = np.zeros_like(q)
        gravity = np.stack([body.inverse_dynamics_along(q, rest, rest) for body in self.along], axis=2)
        return self.weightless.inverse_dynamics_along(q, v, a), gravity


def fall(tilt_rad: FloatArray) -> FloatArray:
    """Fall acceleration in the base's axes, shape (3,), for (pitch, roll) [m/s^2]."""
    return np.array(gravity_base_m_s2(float(tilt_rad[0]), float(tilt_rad[1])))


def fall_slopes(tilt_rad: FloatArray) -> FloatArray:
    """Derivatives of `fall` by pitch and by roll, shape (3, 2) [m/s^2 per rad]."""
    step = 1e-6
    return np.column_stack(
        [(fall(tilt_rad + step * turn) - fall(tilt_rad - step * turn)) / (2 * step) for turn in np.eye(2)]
    )


def design(bodies: GravityBodies, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Columns of the model, linearised: gain, Coulomb, viscous, offset of each joint; then the tilt."""
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
