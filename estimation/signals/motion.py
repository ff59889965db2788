"""Properties of a motion that decide which laws it can tell apart: one way, one speed, one pace."""

import numpy as np

from palpate.estimation.signals.blocks import rows_of_runs
from palpate.robot_io.types import FloatArray, IntArray

_RETURNS = 0.02  # least way back of a returning position, relative to its range
_UNEVEN = 0.1  # largest deviation from constant speed, relative to a run's duration
_SAME_SPEED = 0.2  # relative difference between the speeds of runs
_MOVING = 0.3  # speed relative to the largest below which the motion rests or reverses


def is_one_way(position: FloatArray, run: IntArray) -> bool:
    """Check whether positions (n,) are monotonic in each run (n,), so that time is a function of them.

    A drift with time then looks like a law of the position, without any fault of a sensor.

    Args:
        position: shape (n,).
        run: run of each sample, shape (n,).
    """
    return all(
        min(_way_back(position[rows]), _way_back(-position[rows])) < _RETURNS * np.ptp(position[rows])
        for rows in rows_of_runs(run)
    )


def never_returns(position: FloatArray, run: IntArray) -> bool:
    """Check whether all runs move monotonically in the same direction, so that they show no path memory.

    Args:
        position: shape (n,).
        run: run of each sample, shape (n,).
    """
    ways = {float(np.sign(position[rows[-1]] - position[rows[0]])) for rows in rows_of_runs(run)}
    return len(ways) == 1 and is_one_way(position, run)


def is_one_speed(time_s: FloatArray, position: FloatArray, run: IntArray) -> bool:
    """Check whether all runs move one way at one speed, so that any memory is a function of the position.

    Args:
        time_s: shape (n,) [s].
        position: shape (n,).
        run: run of each sample, shape (n,).
    """
    if not never_returns(position, run):
        return False
    speeds = []
    for rows in rows_of_runs(run):
        way, duration_s = position[rows] - position[rows].mean(), float(np.ptp(time_s[rows]))
        energy = float(way @ way)
        if energy == 0.0:
            return False
        pace = float(way @ time_s[rows]) / energy
        off_s = time_s[rows] - time_s[rows].mean() - pace * way
        if pace == 0.0 or float(np.max(np.abs(off_s))) > _UNEVEN * duration_s:
            return False
        speeds.append(1.0 / pace)
    return float(np.ptp(speeds)) < _SAME_SPEED * float(np.max(np.abs(speeds)))


def is_one_pace(velocity: FloatArray) -> bool:
    """Check whether all motion has one speed, so that a law of the speed is one of the direction.

    Args:
        velocity: shape (n,).
    """
    speed = np.abs(velocity[velocity != 0.0])
    if not len(speed):
        return False
    slow, fast = np.quantile(speed[speed >= _MOVING * np.quantile(speed, 0.95)], [0.1, 0.9])
    return bool(fast < (1.0 + _SAME_SPEED) * slow)


def _way_back(position: FloatArray) -> float:
    """Distance by which a position (n,) lies behind its running maximum."""
    return float(np.max(np.maximum.accumulate(position) - position))
