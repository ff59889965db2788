"""Motions in free air with continuous acceleration: of joints between poses, and of the tip along a line."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, frozen_array

PEAK_SPEED = 15.0 / 8.0  # peak speed of `quintic` over its mean speed
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
_SHORTEST_S = 1e-3  # duration of a move of zero length


class LineState(NamedTuple):
    """Motion along a line: travel [m], speed [m/s] and acceleration [m/s^2], positive into the object."""

    travel_m: float
    speed_m_s: float = 0.0
    acceleration_m_s2: float = 0.0


class JointMotion(NamedTuple):
    """Motion of the joints: position [rad], velocity [rad/s] and acceleration [rad/s^2], shape (n,) each."""

    position_rad: FloatArray
    velocity_rad_s: FloatArray
    acceleration_rad_s2: FloatArray


def quintic(time_s: float, duration_s: float) -> tuple[float, float, float]:
    """Compute 10 s^3 - 15 s^4 + 6 s^5 with s = t / T, from 0 to 1, at rest at both ends.

    Args:
        time_s: t [s].
        duration_s: T [s].

    Returns:
        Value, rate [1/s] and acceleration [1/s^2].
    """
    s = time_s / duration_s
    if not 0.0 < s < 1.0:
        return float(s > 0.0), 0.0, 0.0
    return (
        s**3 * (10.0 + s * (-15.0 + 6.0 * s)),
        30.0 * s**2 * (1.0 - s) ** 2 / duration_s,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration_s**2,
    )


class JointMove:
    """All joints from rest to rest along quintics of one duration.

    Args:
        start_rad: joint positions, shape (n,) [rad].
        end_rad: joint positions, shape (n,) [rad].
        speed_limit_rad_s: limit of every joint [rad/s].
        acceleration_limit_rad_s2: limit of every joint [rad/s^2].

    Raises:
        InputError: a limit is not positive.
    """

    def __init__(
        self,
        start_rad: FloatArray,
        end_rad: FloatArray,
        speed_limit_rad_s: float,
        acceleration_limit_rad_s2: float,
    ) -> None:
        if not (speed_limit_rad_s > 0.0 and acceleration_limit_rad_s2 > 0.0):
            raise InputError(
                f"joint move: limits {speed_limit_rad_s} rad/s and {acceleration_limit_rad_s2} rad/s^2 "
                "must be positive"
            )
        self._start = frozen_array(start_rad, what="start of the move")
        self._change = frozen_array(end_rad, self._start.shape, what="end of the move") - self._start
        longest_rad = float(np.abs(self._change).max())
        self.duration_s = max(
            PEAK_SPEED * longest_rad / speed_limit_rad_s,
            math.sqrt(_PEAK_ACCELERATION * longest_rad / acceleration_limit_rad_s2),
            _SHORTEST_S,
        )

    def at(self, time_s: float) -> JointMotion:
        """Compute the motion at a time.

        Args:
            time_s: time since the start [s]; at rest at the end afterwards.
        """
        return _scaled(self._start, self._change, quintic(time_s, self.duration_s))

    def brake_at(self, time_s: float, acceleration_limit_rad_s2: float) -> "JointBrake":
        """Return a motion that comes to rest during the move.

        Args:
            time_s: time at which the braking begins [s].
            acceleration_limit_rad_s2: limit of every joint [rad/s^2].
        """
        share = LineState(*quintic(time_s, self.duration_s))
        longest_rad = max(float(np.abs(self._change).max()), 1e-9)
        blend = SpeedBlend(share, 0.0, acceleration_limit_rad_s2 / longest_rad)
        return JointBrake(self._start, self._change, blend)


@dataclass(frozen=True, eq=False)
class JointBrake:
    """All joints come to rest together during a move; see `JointMove.brake_at`.

    No joint decelerates more than the limit, if none accelerates when the braking begins.
    """

    start_rad: FloatArray  # start of the move, shape (n,) [rad]
    change_rad: FloatArray  # end minus start, shape (n,) [rad]
    share: "SpeedBlend"  # completed share of the move

    @property
    def duration_s(self) -> float:
        """Duration of the braking [s]."""
        return self.share.duration_s

    def at(self, time_s: float) -> JointMotion:
        """See `JointMove.at`; the time counts from the start of the braking."""
        return _scaled(self.start_rad, self.change_rad, self.share.at(time_s))


def _scaled(start_rad: FloatArray, change_rad: FloatArray, share: tuple[float, float, float]) -> JointMotion:
    value, rate_1_s, acceleration_1_s2 = share
    return JointMotion(start_rad + value * change_rad, rate_1_s * change_rad, acceleration_1_s2 * change_rad)


class JointPath:
    """A sequence of `JointMove`s through points.

    Args:
        points_rad: two or more joint positions, shape (n,) each [rad].
        speed_limit_rad_s: limit of every joint [rad/s].
        acceleration_limit_rad_s2: limit of every joint [rad/s^2].
    """

    def __init__(
        self, points_rad: Sequence[FloatArray], speed_limit_rad_s: float, acceleration_limit_rad_s2: float
    ) -> None:
        self._points = tuple(points_rad)
        self._moves = [
            JointMove(*ends, speed_limit_rad_s, acceleration_limit_rad_s2) for ends in pairwise(points_rad)
        ]
        self.duration_s = sum(move.duration_s for move in self._moves)

    def at(self, time_s: float) -> JointMotion:
        """See `JointMove.at`."""
        index, since_s = self._move_at(time_s)
        return self._moves[index].at(since_s)

    def brake_at(self, time_s: float, acceleration_limit_rad_s2: float) -> JointBrake:
        """See `JointMove.brake_at`."""
        index, since_s = self._move_at(time_s)
        return self._moves[index].brake_at(since_s, acceleration_limit_rad_s2)

    def passed_rad(self, time_s: float) -> tuple[FloatArray, ...]:
        """List the points already passed, the last one first, as a path back, shape (n,) each [rad].

        Args:
            time_s: time since the start [s].
        """
        return self._points[self._move_at(time_s)[0] :: -1]

    def _move_at(self, time_s: float) -> tuple[int, float]:
        """Return the index of the current move, and the time since its start [s]."""
        last = len(self._moves) - 1
        for index, move in enumerate(self._moves[:last]):
            if time_s < move.duration_s:
                return index, time_s
            time_s -= move.duration_s
        return last, time_s


class SpeedBlend:
    """Change of speed along a line; the speed is a cubic polynomial of time.

    Args:
        start: state of motion, whose acceleration is continued.
        speed_m_s: constant speed afterwards [m/s].
        acceleration_limit_m_s2: largest acceleration if the start has none [m/s^2].

    Raises:
        InputError: the limit is not positive.
    """

    def __init__(self, start: LineState, speed_m_s: float, acceleration_limit_m_s2: float) -> None:
        if not acceleration_limit_m_s2 > 0.0:
            raise InputError(f"change of speed: limit {acceleration_limit_m_s2} m/s^2 must be positive")
        self._start = start
        self.speed_m_s = speed_m_s
        change_m_s = speed_m_s - start.speed_m_s
        self.duration_s = 1.5 * max(abs(change_m_s), 1e-3) / acceleration_limit_m_s2
        # speed(t) = v0 + a0 t + b t^2 + c t^3 with speed(T) = v1 and no acceleration at T
        total_s, a0 = self.duration_s, start.acceleration_m_s2
        self._b = (3.0 * change_m_s - 2.0 * a0 * total_s) / total_s**2
        self._c = (a0 * total_s - 2.0 * change_m_s) / total_s**3
        self._end_travel_m = self._during(total_s).travel_m

    def at(self, time_s: float) -> LineState:
        """Compute the motion along the line at a time.

        Args:
            time_s: time since the start [s].
        """
        if time_s >= self.duration_s:
            after_s = time_s - self.duration_s
            return LineState(self._end_travel_m + self.speed_m_s * after_s, self.speed_m_s)
        return self._during(time_s)

    def _during(self, t: float) -> LineState:
        (x0, v0, a0), b, c = self._start, self._b, self._c
        return LineState(
            x0 + t * (v0 + t * (a0 / 2.0 + t * (b / 3.0 + t * c / 4.0))),
            v0 + t * (a0 + t * (b + t * c)),
            a0 + t * (2.0 * b + t * 3.0 * c),
        )


def blend_distance_m(speed_m_s: float, acceleration_limit_m_s2: float) -> float:
    """Compute the distance that a `SpeedBlend` needs between rest and a speed [m].

    Args:
        speed_m_s: the speed [m/s].
        acceleration_limit_m_s2: largest acceleration [m/s^2].
    """
    return 0.75 * speed_m_s**2 / acceleration_limit_m_s2


def turning_distance_m(speed_m_s: float, acceleration_limit_m_s2: float) -> float:
    """Compute the forward distance of a `SpeedBlend` to the opposite speed [m]; 0 for a negative speed.

    Args:
        speed_m_s: speed at its start [m/s].
        acceleration_limit_m_s2: largest acceleration [m/s^2].
    """
    return 0.9375 * max(speed_m_s, 0.0) ** 2 / acceleration_limit_m_s2


class LineReturn:
    """Motion along a line from a state of motion to rest at a travel, with constant speed in between.

    If the distance is too short, the motion overshoots by the stopping distance and ends there.

    Args:
        start: state of motion.
        end_travel_m: travel of the rest position [m].
        speed_m_s: cruising speed, positive [m/s].
        acceleration_limit_m_s2: largest acceleration, as for `SpeedBlend` [m/s^2].

    Raises:
        InputError: the speed is not positive.
    """

    def __init__(
        self, start: LineState, end_travel_m: float, speed_m_s: float, acceleration_limit_m_s2: float
    ) -> None:
        if not speed_m_s > 0.0:
            raise InputError(f"return along the line: speed {speed_m_s} m/s must be positive")
        speed_m_s = math.copysign(speed_m_s, end_travel_m - start.travel_m)
        self._cruise = SpeedBlend(start, speed_m_s, acceleration_limit_m_s2)
        reached = self._cruise.at(self._cruise.duration_s)
        stopping_m = math.copysign(blend_distance_m(speed_m_s, acceleration_limit_m_s2), speed_m_s)
        cruise_s = max((end_travel_m - stopping_m - reached.travel_m) / speed_m_s, 0.0)
        self._stop_at_s = self._cruise.duration_s + cruise_s
        self._stop = SpeedBlend(self._cruise.at(self._stop_at_s), 0.0, acceleration_limit_m_s2)
        self.duration_s = self._stop_at_s + self._stop.duration_s

    def at(self, time_s: float) -> LineState:
        """See `SpeedBlend.at`."""
        if time_s < self._stop_at_s:
            return self._cruise.at(time_s)
        return self._stop.at(time_s - self._stop_at_s)
