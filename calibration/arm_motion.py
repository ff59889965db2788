"""Motions in free air for calibration: an exciting path of all joints, above the ground and below all limits.

No part of the arm goes lower than its lowest point at the start. The path is a finite Fourier series about a
posture. It stays inside the arm's limits and clear of the ground. Source: J. Swevers et al., Optimal robot
excitation and identification, IEEE Trans. Robotics Automation 13(5), 1997.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from palpate.calibration.arm_fit import design_matrix
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.computed_torque import ComputedTorque
from palpate.control.laws.gains import TrackingGains
from palpate.control.loop.task import NO_RUN, Phase, TaskEvent, TaskOutput, make_output
from palpate.control.paths.trajectory import JointMotion, JointMove, quintic
from palpate.robot_io.errors import InputError, SafetyTripError
from palpate.robot_io.guard import Limits
from palpate.robot_io.types import Command, FloatArray, Measurement

MARGIN_M = 0.01  # a motion may go this far below its start, where the arm has been already
_STEP_RAD = 0.05
SHARE = 0.5  # of a limit; the rest is for noise, friction and the controller's corrections
_TORQUE_SHARE = 0.8  # share of the torque limit, mostly for the known weight
_TRAVEL_RAD_S = 0.6
ACCELERATION_RAD_S2 = 2.0
_MOVE_POSTURES = 60  # postures of the way that are checked
_ANGLES = 61  # angles of each joint


def lowest_m(body: RigidBody, postures_rad: Iterable[FloatArray]) -> float:
    """Compute the height of the lowest joint (except the first) or tip over some postures [m].

    Args:
        body: model of the arm.
        postures_rad: joint positions, shape (n,) each [rad].
    """
    return min(float(body.heights_m(posture)[1:].min()) for posture in postures_rad)


def straight_path(start_rad: FloatArray, end_rad: FloatArray) -> FloatArray:
    """List postures along a joint move, shape (k, n) [rad].

    Args:
        start_rad: shape (n,) [rad].
        end_rad: shape (n,) [rad].
    """
    count = max(2, int(np.abs(end_rad - start_rad).max() / _STEP_RAD) + 1)
    return np.linspace(start_rad, end_rad, count)


def cap_speed(speed_rad_s: float, limits: Limits) -> FloatArray:
    """Limit a speed to a share of the joints' velocity limits, shape (n,) [rad/s].

    Args:
        speed_rad_s: intended speed [rad/s].
        limits: limits of the guard.
    """
    return np.minimum(speed_rad_s, SHARE * np.array(limits.velocity_rad_s))


def travel_speed_rad_s(limits: Limits) -> float:
    """Compute the speed of the fastest joint on the paths to a measurement and back [rad/s].

    Args:
        limits: limits of the guard; the joint with the smallest velocity limit determines the speed.
    """
    return float(cap_speed(_TRAVEL_RAD_S, limits).min())


def overloaded_joint(body: RigidBody, motions: Iterable[JointMotion], limits: Limits) -> int | None:
    """Return the most loaded joint (from 0) of the first motion that overloads one; None if none does.

    A joint is overloaded if it needs nearly all of its torque limit.

    Args:
        body: model of the arm.
        motions: motions of all joints.
        limits: limits of the guard.
    """
    for motion in motions:
        share = np.abs(body.inverse_dynamics(*motion)) / np.array(limits.torque_nm)
        if share.max() > _TORQUE_SHARE:
            return int(share.argmax())
    return None


def joint_range(limits: Limits, margin_rad: float) -> tuple[FloatArray, FloatArray]:
    """Compute the lowest and highest positions that keep a distance from the limits, shape (n,) [rad].

    Args:
        limits: limits of the guard.
        margin_rad: distance [rad].

    Raises:
        InputError: a joint's range is too small.
    """
    low = np.array(limits.position_min_rad) + margin_rad
    high = np.array(limits.position_max_rad) - margin_rad
    if np.any(low >= high):
        joint = int(np.argmax(low - high))
        raise InputError(
            f"joint {joint + 1}: limits.position_min_rad and position_max_rad are "
            f"{high[joint] - low[joint] + 2 * margin_rad:.3g} rad apart, but a calibration stays "
            f"{margin_rad:g} rad away from each; widen this range"
        )
    return low, high


def check_lift_path(body: RigidBody, start_rad: FloatArray, up_rad: FloatArray, limits: Limits) -> None:
    """Check that the path up keeps its distance from the ground, and that the torque limits carry the arm.

    Args:
        body: model of the arm.
        start_rad: present joint positions, shape (n,) [rad].
        up_rad: end of the way, shape (n,) [rad].
        limits: limits of the guard.

    Raises:
        InputError: the arm would come closer to the ground on the way, or needs too much torque.
    """
    floor_m = lowest_m(body, [start_rad]) - MARGIN_M
    if not lowest_m(body, straight_path(start_rad, up_rad)) >= floor_m:
        raise InputError(
            "on the way up from this pose, the arm would first sink below it; raise the arm by hand"
        )
    move = JointMove(start_rad, up_rad, travel_speed_rad_s(limits), ACCELERATION_RAD_S2)
    motions = (move.at(time_s) for time_s in np.linspace(0.0, move.duration_s, _MOVE_POSTURES))
    joint = overloaded_joint(body, motions, limits)
    if joint is not None:
        raise InputError(
            f"joint {joint + 1}: its limits.torque_nm, {limits.torque_nm[joint]:g} N m, cannot carry the arm "
            "on its way up; raise this limit, or correct the URDF's masses"
        )


def highest_posture(body: RigidBody, low: FloatArray, high: FloatArray) -> FloatArray:
    """Search joint by joint, on a grid, for the posture (n,) [rad] with the largest sum of heights.

    Args:
        body: model of the arm.
        low: lowest positions, shape (n,) [rad].
        high: highest positions, shape (n,) [rad].
    """
    posture = np.clip(np.zeros(body.joint_count), low, high)
    for _ in range(2):  # joint by joint, since for a chain the sum of heights has one maximum
        for joint in range(body.joint_count):
            candidates = np.repeat(posture[None], _ANGLES, axis=0)
            candidates[:, joint] = np.linspace(low[joint], high[joint], _ANGLES)
            posture = max(candidates, key=lambda q: float(body.heights_m(q).sum()))
    return posture


_FADE_SHARE = 0.1  # share of the duration for the fade-in, and for the fade-out
HARMONICS = 4
_SLOWEST_RAD_S = 0.1  # friction near standstill hides the torques of slower motions
_LIMIT_MARGIN_RAD = 0.15  # distance to the position limits
_CANDIDATES = 24
_POSTURES = 120  # postures of a candidate that are checked
_SIZES = (1.0, 0.8, 0.6, 0.45, 0.3, 0.2)


class FourierPath:
    """q(t) = center + fade(t) sum_k amplitude_k sin(2 pi k t / period + phase_k).

    It starts and ends at rest in the center, fading over a quintic, so that the acceleration is continuous.

    Args:
        center_rad: shape (n,) [rad].
        amplitude_rad: shape (n, harmonics) [rad].
        phase_rad: shape (n, harmonics) [rad].
        period_s: period of the first harmonic [s].
        duration_s: duration of the whole path [s].
    """

    def __init__(
        self,
        center_rad: FloatArray,
        amplitude_rad: FloatArray,
        phase_rad: FloatArray,
        period_s: float,
        duration_s: float,
    ) -> None:
        self.center_rad, self.duration_s = center_rad, duration_s
        self._amplitude, self._phase = amplitude_rad, phase_rad
        self._rate = math.tau / period_s * np.arange(1, amplitude_rad.shape[1] + 1)

    def at(self, time_s: float) -> JointMotion:
        """Compute the motion at a time; at rest before the start and after the end.

        Args:
            time_s: time since the start [s].
        """
        return self._tapered(self._rate * time_s + self._phase, *self._taper(time_s))

    def sample(self, times_s: FloatArray) -> JointMotion:
        """Compute the motion at many times at once; its parts have shape (m, n).

        Args:
            times_s: time since the start, shape (m,) [s].
        """
        taper = np.array([self._taper(time_s) for time_s in times_s.tolist()]).T[..., None]
        return self._tapered(times_s[:, None, None] * self._rate + self._phase, *taper)

    def _taper(self, time_s: float) -> tuple[float, float, float]:
        """Return the share of the full motion and its derivatives; the fade-out mirrors the fade-in."""
        is_first = time_s <= 0.5 * self.duration_s
        since_s = time_s if is_first else self.duration_s - time_s
        fade, fade_rate, fade_acceleration = quintic(since_s, _FADE_SHARE * self.duration_s)
        return fade, fade_rate if is_first else -fade_rate, fade_acceleration

    def _tapered(
        self,
        angle: FloatArray,
        fade: float | FloatArray,
        fade_rate: float | FloatArray,
        fade_acceleration: float | FloatArray,
    ) -> JointMotion:
        """Return the motion at these angles of the harmonics (..., n, harmonics) [rad]."""
        sine, cosine = self._amplitude * np.sin(angle), self._amplitude * np.cos(angle)
        wave, speed, acceleration = sine.sum(axis=-1), cosine @ self._rate, -(sine @ self._rate**2)
        return JointMotion(
            self.center_rad + fade * wave,
            fade * speed + fade_rate * wave,
            fade * acceleration + 2.0 * fade_rate * speed + fade_acceleration * wave,
        )


@dataclass(frozen=True)
class ExcitationSettings:
    """Size and speed of an exciting motion."""

    duration_s: float  # of the whole motion [s]
    period_s: float  # of its slowest part [s]
    amplitude_rad: float = 1.0  # of a joint, if nothing is in the way [rad]
    speed_rad_s: float = 1.5  # of the fastest joint at most [rad/s]


TORQUE_MOTION = ExcitationSettings(duration_s=40.0, period_s=10.0)
GRAVITY_MOTION = ExcitationSettings(duration_s=60.0, period_s=30.0, speed_rad_s=0.4)


def choose_path(
    body: RigidBody,
    start_rad: FloatArray,
    limits: Limits,
    *,
    settings: ExcitationSettings,
    rng: np.random.Generator,
) -> FourierPath:
    """Choose the most informative of several random paths around the highest posture.

    The most informative path has the largest determinant of the normal equations (D-optimal) of gains,
    offsets, friction and tilt. No part goes below its present height. Equal seeds give the same path.

    Args:
        body: model of the arm.
        start_rad: present joint positions, shape (n,) [rad].
        limits: limits of the guard.
        settings: size and speed.
        rng: random numbers.

    Raises:
        InputError: no motion is clear of the ground and inside the limits, or all are too slow.
    """
    floor_m = lowest_m(body, [start_rad]) - MARGIN_M
    low, high = joint_range(limits, _LIMIT_MARGIN_RAD)
    speed = cap_speed(settings.speed_rad_s, limits)
    joint = int(speed.argmin())
    if speed[joint] < _SLOWEST_RAD_S:
        raise InputError(
            f"limits.velocity_rad_s of joint {joint + 1} is {limits.velocity_rad_s[joint]:g} rad/s, too slow "
            f"to tell friction from weight; this motion needs {_SLOWEST_RAD_S / SHARE:g} rad/s or more"
        )
    center = highest_posture(body, low, high)
    check_lift_path(body, start_rad, center, limits)
    times = np.linspace(0.0, settings.duration_s, _POSTURES)
    best: tuple[float, FourierPath] | None = None
    for _ in range(_CANDIDATES):
        shape = (
            rng.uniform(0.3, 1.0, (body.joint_count, HARMONICS)),
            rng.uniform(-math.pi, math.pi, (body.joint_count, HARMONICS)),
        )
        for path in _shrunk_paths(center, shape, settings, (low, high), speed):
            motion = path.sample(times)
            each = (JointMotion(*row) for row in zip(*motion, strict=True))
            is_clear = lowest_m(body, motion.position_rad) >= floor_m
            if is_clear and overloaded_joint(body, each, limits) is None:
                columns = design_matrix(body, *motion)
                norms = np.linalg.norm(columns, axis=0)
                sign, size = np.linalg.slogdet(columns[:, norms > 0].T @ columns[:, norms > 0])
                score = float(size) if sign > 0 else -math.inf
                best = (score, path) if best is None or score > best[0] else best
                break
    if best is None:
        raise InputError(
            "no motion stays above the arm's present height and within its torque limits: "
            "raise the arm first, or increase limits.torque_nm"
        )
    return best[1]


def _shrunk_paths(
    center: FloatArray,
    shape: tuple[FloatArray, FloatArray],
    settings: ExcitationSettings,
    bounds: tuple[FloatArray, FloatArray],
    speed: FloatArray,
) -> Iterator[FourierPath]:
    """Yield one path at decreasing sizes, each within the limits of position and speed."""
    (low, high), (amplitude, phase) = bounds, shape
    period_s = settings.period_s
    times = np.linspace(0.0, settings.duration_s, 10 * _POSTURES)
    unit = FourierPath(np.zeros(len(center)), amplitude, phase, period_s, settings.duration_s)
    motion = unit.sample(times)
    peak_rad, peak_rad_s = np.abs(motion.position_rad).max(axis=0), np.abs(motion.velocity_rad_s).max(axis=0)
    room = np.minimum(np.minimum(high - center, center - low), settings.amplitude_rad)
    scale = np.minimum(room / peak_rad, speed / peak_rad_s)
    for share in _SIZES:
        yield FourierPath(center, share * scale[:, None] * amplitude, phase, period_s, settings.duration_s)


TOUCH_N = 5.0  # largest difference of the force from its value at the start [N]
_TOUCH_TICKS = 3
_REST_RAD_S = 0.05
_REST_WAIT_S = 2.0
_SETTLE_S = 0.3


class FreeMotion:
    """Tracks a joint motion in free air, stops if the force changes, and makes the output of the task."""

    def __init__(self, body: RigidBody, gains: TrackingGains) -> None:
        self.body = body
        self._torque = ComputedTorque(body, gains)
        self._no_contact = np.zeros(body.joint_count)
        self._touched_ticks = 0
        self._free_air_n = 0.0

    def start(self, measurement: Measurement) -> None:
        """Begin from rest; the present force counts as that of free air.

        Args:
            measurement: state of the arm.
        """
        self._torque.reset()
        self._touched_ticks = 0
        self._free_air_n = measurement.force_n if math.isfinite(measurement.force_n) else 0.0

    def reset(self) -> None:
        """Clear the feedback's integral, for example after pressing on a stop."""
        self._torque.reset()

    def torque_nm(self, measurement: Measurement, motion: JointMotion, dt_s: float) -> FloatArray:
        """Compute joint torques that follow a motion, shape (n,) [N m].

        Args:
            measurement: state of the arm.
            motion: reference of the joints.
            dt_s: time since the last tick [s].

        Raises:
            SafetyTripError: the force sensor reads more than `TOUCH_N` away from free air.
        """
        difference_n = measurement.force_n - self._free_air_n
        self._touched_ticks = self._touched_ticks + 1 if abs(difference_n) > TOUCH_N else 0
        if self._touched_ticks >= _TOUCH_TICKS:
            raise SafetyTripError(
                f"{difference_n:.1f} N on the tool: remove the obstacle. If there is none, remove any load "
                "from the tool, because its weight acts in a different direction when the tool turns"
            )
        return self._torque.step(measurement, motion, self._no_contact, dt_s)

    def at_rest(self, measurement: Measurement, waited_s: float) -> bool:
        """Return whether the arm stands still; raise `SafetyTripError` if it still moves after 2 s.

        Args:
            measurement: state of the arm.
            waited_s: time since its motion should have ended [s].
        """
        is_at_rest = float(np.abs(measurement.joint_velocity_rad_s).max()) < _REST_RAD_S
        if not is_at_rest and waited_s > _REST_WAIT_S:
            raise SafetyTripError(
                "the arm has returned but does not come to rest; if it shakes, lower "
                "gains.tracking.bandwidth_rad_s in the robot file"
            )
        return is_at_rest

    def output(
        self,
        measurement: Measurement,
        motion: JointMotion,
        torque_nm: FloatArray,
        phase: Phase,
        run: int = NO_RUN,
        *,
        done: bool = False,
        events: tuple[TaskEvent, ...] = (),
    ) -> TaskOutput:
        """Make the output of a tick; without an object the direction into it is zero.

        Args:
            measurement: state of the arm.
            motion: reference of the joints.
            torque_nm: command, shape (n,) [N m].
            phase: phase of the task.
            run: number of the run, or `NO_RUN`.
            done: whether the task has ended.
            events: events of the tick.
        """
        tip = self.body.tip_motion(measurement.joint_position_rad, measurement.joint_velocity_rad_s)
        return make_output(
            Command(torque_nm), motion, tip, np.zeros(3), phase, run=run, done=done, events=events
        )


class PathTask:
    """Moves to a path, follows it and moves back; see `palpate.control.loop.task.Task`.

    The path's ticks are run 0.
    """

    def __init__(self, body: RigidBody, gains: TrackingGains, path: FourierPath, travel_rad_s: float) -> None:
        self._free = FreeMotion(body, gains)
        self._path, self._travel_rad_s = path, travel_rad_s
        self._time_s = 0.0
        self.duration_s = path.duration_s  # including the moves to the path and back, once started

    def start(self, measurement: Measurement) -> None:
        """Plan the moves from the measured pose to the path's center and back.

        Args:
            measurement: state of the arm.
        """
        self._free.start(measurement)
        self._time_s = 0.0
        start_rad, center_rad = measurement.joint_position_rad.copy(), self._path.center_rad
        self._move_to_start = JointMove(start_rad, center_rad, self._travel_rad_s, ACCELERATION_RAD_S2)
        self._back = JointMove(center_rad, start_rad, self._travel_rad_s, ACCELERATION_RAD_S2)
        self._begin_s = self._move_to_start.duration_s + _SETTLE_S
        self._end_s = self._begin_s + self._path.duration_s
        self.duration_s = self._end_s + self._back.duration_s + _SETTLE_S

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """Move to the path's center, follow the path once, and return.

        Args:
            measurement: state of the arm.
            dt_s: time since the last tick [s].
        """
        self._time_s += dt_s
        if self._time_s < self._begin_s:
            motion, phase, run = self._move_to_start.at(self._time_s), Phase.MOVE, NO_RUN
        elif self._time_s < self._end_s:
            motion, phase, run = self._path.at(self._time_s - self._begin_s), Phase.FREE_AIR, 0
        else:
            motion, phase, run = self._back.at(self._time_s - self._end_s), Phase.MOVE, NO_RUN
        torque_nm = self._free.torque_nm(measurement, motion, dt_s)
        over_s = self._time_s - self.duration_s
        done = over_s >= 0.0 and self._free.at_rest(measurement, over_s)
        events = (TaskEvent("motion_done", "the motion is done"),) if done else ()
        return self._free.output(
            measurement, motion, torque_nm, Phase.IDLE if done else phase, run, done=done, events=events
        )
