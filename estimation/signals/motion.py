"""Properties of a motion that determine which laws it can distinguish: monotonic, or with one speed."""

import numpy as np

from palpate.estimation.signals.blocks import rows_of_runs
from palpate.robot_io.types import FloatArray, IntArray

_RETURNS = 0.02  # least return travel of a returning position, relative to its range
_UNEVEN = 0.1  # largest deviation from constant speed, relative to a run's duration
_SAME_SPEED = 0.2  # relative difference between the speeds of runs
_MOVING = 0.3  # speed relative to the largest one below which the motion is at rest or reverses


def is_one_way(position: FloatArray, run: IntArray) -> bool:
    """Return whether the position is monotonic in each run.

    Time is then a function of the position, so that a drift looks like a law of the position.

    Args:
        position: position, shape (n,).
        run: run number of each sample, shape (n,).
    """
    return all(
        min(_way_back(position[rows]), _way_back(-position[rows])) < _RETURNS * np.ptp(position[rows])
        for rows in rows_of_runs(run)
    )


def never_returns(position: FloatArray, run: IntArray) -> bool:
    """Return whether all runs move monotonically in the same direction, so that path memory is invisible.

    Args:
        position: position, shape (n,).
        run: run number of each sample, shape (n,).
    """
    ways = {float(np.sign(position[rows[-1]] - position[rows[0]])) for rows in rows_of_runs(run)}
    return len(ways) == 1 and is_one_way(position, run)


def is_one_speed(time_s: FloatArray, position: FloatArray, run: IntArray) -> bool:
    """Return whether all runs move in one direction at one speed.

    Any memory is then a function of the position.

    Args:
        time_s: times, shape (n,) [s].
        position: position, shape (n,).
        run: run number of each sample, shape (n,).
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
    """Return whether all motion has one speed, in either direction.

    A law of the speed then looks like a law of the direction.

    Args:
        velocity: velocity, shape (n,).
    """
    speed = np.abs(velocity[velocity != 0.0])
    if not len(speed):
        return False
    slow, fast = np.quantile(speed[speed >= _MOVING * np.quantile(speed, 0.95)], [0.1, 0.9])
    return bool(fast < (1.0 + _SAME_SPEED) * slow)


def _way_back(position: FloatArray) -> float:
    """Return the largest distance of a position (n,) below its running maximum."""
    return float(np.max(np.maximum.accumulate(position) - position))
