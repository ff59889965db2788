"""What a controller follows: a motion of the joints, or a motion along the press line."""

from typing import NamedTuple

from robot_io.types import FloatArray


class LineState(NamedTuple):
    """Motion along the line: travel [m], speed [m/s] and acceleration [m/s^2], positive into the object."""

    travel_m: float
    speed_m_s: float = 0.0
    acceleration_m_s2: float = 0.0


class JointMotion(NamedTuple):
    """Joint positions [rad], velocities [rad/s] and accelerations [rad/s^2], shape (n,) each."""

    position_rad: FloatArray
    velocity_rad_s: FloatArray
    acceleration_rad_s2: FloatArray
