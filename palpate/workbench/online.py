"""What the estimates made in the loop leave of the force, for those who watch it."""

import numpy as np

from robot_io.session import Samples
from robot_io.types import FloatArray


def online_residual(ticks: Samples) -> FloatArray:
    """Force less that of the online estimates of k, c and surface, (n,) [N]; NaN where there are none."""
    along = np.sum(ticks["tip_position_world_m"] * ticks["press_direction_world"], axis=1)
    speed = np.sum(ticks["tip_velocity_world_m_s"] * ticks["press_direction_world"], axis=1)
    depth = along - ticks["surface_m"]
    expected = np.where(depth > 0.0, ticks["stiffness_n_m"] * depth + ticks["damping_n_s_m"] * speed, 0.0)
    left: FloatArray = ticks["force_n"] - np.maximum(expected, 0.0)
    return left
