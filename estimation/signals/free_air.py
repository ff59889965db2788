"""What a recording says of a sensor's zero and its drift: readings in free air, and positions that return."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.robot_io.types import FloatArray, IntArray

_FREE = 0.9  # of the samples before a touch; the last of them may already belong to it
_WINDOW = 50  # readings at most, at the end of a run
_FEWEST = 5  # readings, at each end
_HIDDEN = 0.5  # of the noise, below which a zero does not show
_RETURNS = 0.02  # of the range, below which a position does not return
_UNEVEN = 0.1  # of a run's duration, by which a position may come early or late at one speed
_SAME_SPEED = 0.2  # of a speed, by which those of other runs may differ
_MOVING = 0.3  # of the largest speed: what is slower rests or turns
_SIGMAS = 3.0  # standard errors, below which a rate is not known to differ from zero


@dataclass(frozen=True)
class FreeAirZero:
    """A sensor's zero, from readings while nothing is touched."""

    noise: float  # standard deviation of readings before the first touch, about each run's mean [effort]
    bias: float  # mean of these readings [effort]
    rate: float | None  # change with time from the start to the end of runs [effort/s]; None if not known
    rate_std_err: float  # of the rate, for white noise
    duration_s: float  # from the first to the last reading of the channel

    @property
    def is_zero(self) -> bool:
        """Whether the readings before the touch show no bias."""
        return abs(self.bias) < _HIDDEN * self.noise

    @property
    def is_steady(self) -> bool:
        """Whether the readings at the ends of runs show no drift over the whole recording."""
        if self.rate is None:
            return False
        unseen = max(_HIDDEN * self.noise, _SIGMAS * self.rate_std_err * self.duration_s)
        return abs(self.rate) * self.duration_s < unseen


def zero_in_free_air(data: ChannelData) -> FreeAirZero | None:
    """Measure a sensor's zero in the runs that begin in free air.

    Args:
        data: channel with n samples.

    Returns:
        None for joints, and where no run begins in free air.
    """
    if data.kind is not ChannelKind.CONTACT:
        return None
    before, apart_s, apart, spread = [], [], [], []
    for rows in rows_of_runs(data.run):
        touched = np.flatnonzero(data.engaged[rows])
        first = rows[: int(_FREE * (touched[0] if len(touched) else len(rows)))]
        if len(first) < _FEWEST:
            continue
        before.append(data.effort[first])
        last = rows[touched[-1] + 1 :][-_WINDOW:] if len(touched) else first[:0]
        if len(last) >= _FEWEST:
            start = first[: len(last)]
            apart_s.append(data.time_s[last].mean() - data.time_s[start].mean())
            apart.append(data.effort[last].mean() - data.effort[start].mean())
            spread.append(2.0 / len(start))
    if not before:
        return None
    noise = float(np.std(np.concatenate([part - part.mean() for part in before])))
    bias, energy = float(np.concatenate(before).mean()), float(np.vdot(apart_s, apart_s))
    rate = float(np.vdot(apart_s, apart)) / energy if energy > 0.0 else None
    error = noise * float(np.sqrt(max(spread) / energy)) if energy > 0.0 else np.inf
    return FreeAirZero(noise, bias, rate, error, float(np.ptp(data.time_s)))


def is_one_way(position: FloatArray, run: IntArray) -> bool:
    """Whether positions (n,) only go one way in each run (n,), so that time cannot be told from them.

    What drifts with time then looks like a law of the position, which needs no sensor to fail.

    Args:
        position: shape (n,).
        run: of each sample, shape (n,).
    """
    return all(
        min(_way_back(position[rows]), _way_back(-position[rows])) < _RETURNS * np.ptp(position[rows])
        for rows in rows_of_runs(run)
    )


def never_returns(position: FloatArray, run: IntArray) -> bool:
    """Whether positions (n,) go the same one way in all runs, so that memory of the path is a law of them.

    Args:
        position: shape (n,).
        run: of each sample, shape (n,).
    """
    ways = {float(np.sign(position[rows[-1]] - position[rows[0]])) for rows in rows_of_runs(run)}
    return len(ways) == 1 and is_one_way(position, run)


def is_one_speed(time_s: FloatArray, position: FloatArray, run: IntArray) -> bool:
    """Whether all runs go one way at one speed, so that whatever has a memory is a law of the position.

    Args:
        time_s: shape (n,) [s].
        position: shape (n,).
        run: of each sample, shape (n,).
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
    """Whether all motion is equally fast, to either side, so that a law of the speed is one of the direction.

    Args:
        velocity: shape (n,).
    """
    speed = np.abs(velocity[velocity != 0.0])
    if not len(speed):
        return False
    slow, fast = np.quantile(speed[speed >= _MOVING * np.quantile(speed, 0.95)], [0.1, 0.9])
    return bool(fast < (1.0 + _SAME_SPEED) * slow)


def _way_back(position: FloatArray) -> float:
    """How far a position (n,) falls behind the farthest that it was."""
    return float(np.max(np.maximum.accumulate(position) - position))
