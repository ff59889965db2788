"""Keeps a motion above the ground: no part of the arm goes lower than its lowest point at the start."""

from collections.abc import Iterable

import numpy as np

from control.arm.rigid_body import RigidBody
from robot_io.types import FloatArray

MARGIN_M = 0.01
_STEP_RAD = 0.05


def lowest_m(body: RigidBody, postures_rad: Iterable[FloatArray]) -> float:
    """Height [m] of the lowest joint (but the first) or tip over some postures, each (n,) [rad]."""
    return min(float(body.heights_m(posture)[1:].min()) for posture in postures_rad)


def straight_way(start_rad: FloatArray, end_rad: FloatArray) -> FloatArray:
    """Postures on the way of a joint move, shape (k, n) [rad]."""
    count = max(2, int(np.abs(end_rad - start_rad).max() / _STEP_RAD) + 1)
    return np.linspace(start_rad, end_rad, count)


def is_clear(body: RigidBody, postures_rad: Iterable[FloatArray], floor_m: float) -> bool:
    """Whether nothing comes nearer to the floor than the margin, which is where the arm has been already."""
    return lowest_m(body, postures_rad) >= floor_m - MARGIN_M
