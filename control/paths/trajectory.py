"""Motions for free air, continuous to acceleration: a move between joint positions, and a change of speed."""

import math

import numpy as np

from control.paths.motion import JointMotion, LineState
from robot_io.errors import InputError
from robot_io.types import FloatArray, frozen_array

# Peaks of the quintic p(s) = 10 s^3 - 15 s^4 + 6 s^5 from rest to rest.
_PEAK_SPEED = 15.0 / 8.0
_SHORTEST_S = 1e-3  # also of a move of no length
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)


class JointMove:
    """All joints from rest to rest along quintics of the same duration.

    Args:
        start_rad: shape (n,) [rad].
        end_rad: shape (n,) [rad].
        speed_limit_rad_s: no joint moves faster [rad/s].
        acceleration_limit_rad_s2: no joint accelerates more [rad/s^2].

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
        self._way = frozen_array(end_rad, self._start.shape, what="end of the move") - self._start
        longest_rad = float(np.abs(self._way).max())
        self.duration_s = max(
            _PEAK_SPEED * longest_rad / speed_limit_rad_s,
            math.sqrt(_PEAK_ACCELERATION * longest_rad / acceleration_limit_rad_s2),
            _SHORTEST_S,
        )

    def at(self, time_s: float) -> JointMotion:
        """Motion `time_s` [s] after the start; at rest at the end afterwards."""
        return _on_way(self._start, self._way, self._along(time_s))

    def brake_at(self, time_s: float, acceleration_limit_rad_s2: float) -> "JointBrake":
        """Come to rest on the way, from the motion at `time_s` [s] on, with another limit [rad/s^2]."""
        return JointBrake(self._start, self._way, self._along(time_s), acceleration_limit_rad_s2)

    def _along(self, time_s: float) -> LineState:
        """Share of the way, and its derivatives."""
        if time_s >= self.duration_s:
            return LineState(1.0)
        s = max(time_s, 0.0) / self.duration_s
        return LineState(
            s**3 * (10.0 + s * (-15.0 + 6.0 * s)),
            30.0 * s**2 * (1.0 - s) ** 2 / self.duration_s,
            60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / self.duration_s**2,
        )


class JointBrake:
    """All joints come to rest together, on the way that they were on; see `JointMove.brake_at`.

    Args:
        start_rad: where the way begins, shape (n,) [rad].
        way_rad: to its end, shape (n,) [rad].
        along: share of the way, and its derivatives, when the braking begins.
        acceleration_limit_rad_s2: no joint decelerates more, if none accelerates when it begins [rad/s^2].
    """

    def __init__(
        self, start_rad: FloatArray, way_rad: FloatArray, along: LineState, acceleration_limit_rad_s2: float
    ) -> None:
        self._start, self._way = start_rad, way_rad
        longest_rad = max(float(np.abs(way_rad).max()), 1e-9)
        self._blend = SpeedBlend(along, 0.0, acceleration_limit_rad_s2 / longest_rad)
        self.duration_s = self._blend.duration_s

    def at(self, time_s: float) -> JointMotion:
        """Motion `time_s` [s] after the braking began; at rest afterwards."""
        return _on_way(self._start, self._way, self._blend.at(time_s))


def _on_way(start_rad: FloatArray, way_rad: FloatArray, along: LineState) -> JointMotion:
    share, rate_1_s, acceleration_1_s2 = along
    return JointMotion(start_rad + share * way_rad, rate_1_s * way_rad, acceleration_1_s2 * way_rad)


class SpeedBlend:
    """Along a line: from a state of motion to a constant speed, the speed a cubic in time.

    Args:
        start: where it begins; its acceleration is taken up.
        speed_m_s: final speed, kept from then on [m/s].
        acceleration_limit_m_s2: largest acceleration, if the start has none [m/s^2].

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
        """Motion `time_s` [s] after the start."""
        if time_s >= self.duration_s:
            after_s = time_s - self.duration_s
            return LineState(self._end_travel_m + self.speed_m_s * after_s, self.speed_m_s)
        return self._during(time_s)

    def _during(self, t: float) -> LineState:
        start, b, c = self._start, self._b, self._c
        v0, a0 = start.speed_m_s, start.acceleration_m_s2
        return LineState(
            start.travel_m + t * (v0 + t * (a0 / 2.0 + t * (b / 3.0 + t * c / 4.0))),
            v0 + t * (a0 + t * (b + t * c)),
            a0 + t * (2.0 * b + t * 3.0 * c),
        )


def blend_distance_m(speed_m_s: float, acceleration_limit_m_s2: float) -> float:
    """Way [m] that a `SpeedBlend` needs between rest and a speed [m/s], either way."""
    return 0.75 * speed_m_s**2 / acceleration_limit_m_s2


def turning_distance_m(speed_m_s: float, acceleration_limit_m_s2: float) -> float:
    """Way [m] on which a `SpeedBlend` to the opposite speed still goes forward; 0 for a negative speed."""
    return 0.9375 * max(speed_m_s, 0.0) ** 2 / acceleration_limit_m_s2


class LineReturn:
    """Along a line: from a state of motion to rest at a travel, cruising at a speed in between.

    If the way is too short to cruise, it overshoots by what stopping needs and rests there.

    Args:
        start: where it begins; its acceleration is taken up.
        end_travel_m: where it rests [m].
        speed_m_s: cruising speed, positive [m/s].
        acceleration_limit_m_s2: as for `SpeedBlend` [m/s^2].

    Raises:
        InputError: speed or limit is not positive.
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
        """Motion `time_s` [s] after the start."""
        if time_s < self._stop_at_s:
            return self._cruise.at(time_s)
        return self._stop.at(time_s - self._stop_at_s)
