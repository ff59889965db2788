"""Properties of a motion that determine which laws it can distinguish, such as its speeds and reversals."""

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.cache_by_array import cache_by_channel_arrays
from palpate.robot_io.types import FloatArray, IntArray

_MIN_RETURN = 0.02  # least travel against the main direction of a motion that returns, relative to its range
_MAX_UNEVENNESS = 0.1  # largest time error of a motion at constant speed, relative to a run's duration
_SAME_SPEED = 0.2  # largest relative difference between speeds that count as equal
FEW_LEVELS = 12  # largest number of distinct values of an effort that may consist of steps
_STEP_REACH = 5  # samples before and after a step of the effort whose accelerations are compared
# Least share of steps that the acceleration follows in their direction, and least ratio of its changes at
# steps to those at other times. A rounded sine gives a ratio of the square root of two.
_FORWARD, _STEP_RATIO = 0.8, 3.0
_FEWEST_ROUNDED = 3  # number of values above which an even spacing indicates rounding
# Share of the speed by which it changes, and of the runs in which it does, under constant efforts.
_HALF = 0.5
_OFF_GRID = 0.05  # largest distance of a rounded value from a multiple of the step, in steps
_EVEN = 1e-3  # largest relative difference between the distances of evenly spaced values
_PARTS, _STEPS = 20, 400  # a hold lasts one of these parts of a run, and begins at any of these steps
_HOLD_SHARE = 0.05  # largest speed in a hold, relative to the mean speed
_MOVING_SHARE = 0.3  # speed relative to the largest one below which the motion is at rest or reverses


def is_monotonic(position: FloatArray, run: IntArray) -> bool:
    """Return whether the position is monotonic in each run, or returns in only one run of several.

    Time is then a function of the position, so that a drift looks like a law of the position. Of several
    runs, at least two must return: what is found in one run must be confirmed by another.

    Args:
        position: position, shape (n,).
        run: run number of each sample, shape (n,).
    """
    returns = [
        min(_retreat(position[rows]), _retreat(-position[rows])) >= _MIN_RETURN * np.ptp(position[rows])
        for rows in rows_of_runs(run)
    ]
    return bool(np.count_nonzero(returns) < min(2, len(returns)))


def never_returns(position: FloatArray, run: IntArray) -> bool:
    """Return whether all runs move monotonically in the same direction, which hides any path memory.

    Args:
        position: position, shape (n,).
        run: run number of each sample, shape (n,).
    """
    directions = {float(np.sign(position[rows[-1]] - position[rows[0]])) for rows in rows_of_runs(run)}
    return len(directions) == 1 and is_monotonic(position, run)


def is_one_pass(time_s: FloatArray, position: FloatArray, run: IntArray) -> bool:
    """Return whether all runs move in one direction at one speed, or a single run does so without a hold.

    Any memory is then a function of the position.

    Args:
        time_s: times, shape (n,) [s].
        position: position, shape (n,).
        run: run number of each sample, shape (n,).
    """
    if not never_returns(position, run):
        return False
    if run[0] == run[-1]:
        even = np.interp(np.linspace(time_s[0], time_s[-1], _STEPS + 1), time_s, position)
        moved = np.abs(even[_STEPS // _PARTS :] - even[: -(_STEPS // _PARTS)])
        if not moved.min() < _HOLD_SHARE * np.ptp(position) / _PARTS:
            return True
    speeds = []
    for rows in rows_of_runs(run):
        displacement, duration_s = position[rows] - position[rows].mean(), float(np.ptp(time_s[rows]))
        energy = float(displacement @ displacement)
        if energy == 0.0:
            return False
        slowness = float(displacement @ time_s[rows]) / energy
        deviation_s = time_s[rows] - time_s[rows].mean() - slowness * displacement
        if slowness == 0.0 or float(np.max(np.abs(deviation_s))) > _MAX_UNEVENNESS * duration_s:
            return False
        speeds.append(1.0 / slowness)
    return float(np.ptp(speeds)) < _SAME_SPEED * float(np.max(np.abs(speeds)))


def has_constant_speed(velocity: FloatArray) -> bool:
    """Return whether all motion has one speed, in either direction.

    A law of the speed then looks like a law of the direction.

    Args:
        velocity: velocity, shape (n,).
    """
    speed = np.abs(velocity[velocity != 0.0])
    if not len(speed):
        return False
    slow, fast = np.quantile(speed[speed >= _MOVING_SHARE * np.quantile(speed, 0.95)], [0.1, 0.9])
    return bool(fast < (1.0 + _SAME_SPEED) * slow)


def _retreat(position: FloatArray) -> float:
    """Return the largest distance of a position (n,) below its running maximum."""
    return float(np.max(np.maximum.accumulate(position) - position))


def is_constant_in_runs(data: ChannelData) -> bool:
    """Return whether the effort does not change within any run.

    Args:
        data: the channel.
    """
    return all(np.ptp(data.effort[rows]) == 0.0 for rows in rows_of_runs(data.run))


@cache_by_channel_arrays("kind", "is_command", "velocity", "effort", "run")
def is_stepwise_command(data: ChannelData) -> bool:
    """Return whether a joint's effort is a command that changes in steps, such as a motor's voltage.

    The acceleration follows a real step of the effort at once and in its direction. A sensor that rounds a
    continuous effort also shows steps, but the acceleration does not change more at these steps than at other
    times. More than three evenly spaced values may be rounded readings, and are not called a command. An
    exception is an effort that is constant in each run while the velocity changes by half or more, because
    readings of a sensor would change with the velocity. Two opposite values without zero are always a
    command, because a sensor that rounds has a reading near zero. Values are also a command if their
    distances are not multiples of the smallest distance.

    Args:
        data: the channel.
    """
    if data.is_command or data.kind is ChannelKind.CONTACT:
        return data.is_command
    levels = np.unique(data.effort)
    if is_constant_in_runs(data):
        speeds = [data.velocity[rows] for rows in rows_of_runs(data.run)]
        accelerates = [np.ptp(speed) > _HALF * np.max(np.abs(speed)) for speed in speeds]
        return len(levels) > 1 and bool(np.mean(accelerates) > _HALF)
    if len(levels) > FEW_LEVELS:
        return False
    distances = np.diff(levels)
    in_steps = distances / distances.min()
    is_off_grid = (
        distances.min() > _EVEN * np.ptp(levels) and np.abs(in_steps - np.round(in_steps)).max() > _OFF_GRID
    )
    if is_off_grid or (len(levels) == 2 and levels[0] == -levels[1]):
        return True
    if len(levels) > _FEWEST_ROUNDED and np.ptp(distances) < _EVEN * distances.mean():
        return False
    at_steps, elsewhere = [np.zeros(0)], [np.zeros(0)]
    for rows in rows_of_runs(data.run):
        if len(rows) < 2 * _STEP_REACH:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(data.velocity[rows], _STEP_REACH)
        slopes = windows @ (np.arange(_STEP_REACH) - 0.5 * (_STEP_REACH - 1))
        changes = slopes[_STEP_REACH:] - slopes[:-_STEP_REACH]
        # The step from the last sample of the earlier window to the first sample of the later one.
        of_change = slice(_STEP_REACH - 1, len(rows) - _STEP_REACH)
        steps = np.diff(data.effort[rows])
        is_near = np.convolve(steps != 0.0, np.ones(2 * _STEP_REACH - 1))[_STEP_REACH - 1 :][of_change] > 0.5
        steps = steps[of_change]
        at_steps.append((np.sign(steps) * changes)[steps != 0.0])
        elsewhere.append(changes[~is_near])
    stepped, others = np.concatenate(at_steps), np.concatenate(elsewhere)
    is_followed = len(stepped) > 0 and np.mean(stepped > 0.0) >= _FORWARD
    return bool(
        is_followed and len(others) > 0 and np.median(stepped) > _STEP_RATIO * np.sqrt(np.mean(others**2))
    )
