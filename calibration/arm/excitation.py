"""A motion of all joints that excites what is to be identified: a finite Fourier series about a posture.

It stays inside the arm's limits and clear of the ground, and tells as much as it can.

J. Swevers et al., Optimal robot excitation and identification, IEEE Trans. Robotics Automation 13(5), 1997.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calibration.arm.model import GravityBodies, design
from calibration.arm.room import SHARE, check_way_up, highest_posture, is_clear, overloaded_joint, paced, room
from control.arm.rigid_body import RigidBody
from control.paths.trajectory import JointMotion, quintic
from robot_io.errors import InputError
from robot_io.guard import Limits
from robot_io.types import FloatArray

_FADE_SHARE = 0.1  # of the duration, from rest to the full motion and back
HARMONICS = 4
_SLOWEST_RAD_S = 0.1  # friction near standstill hides the torques of slower motions
_LIMIT_MARGIN_RAD = 0.15  # stays so far from the position limits
_CANDIDATES = 24
_LOOKS = 120  # postures of a candidate that are looked at
_SHRINKING = (1.0, 0.8, 0.6, 0.45, 0.3, 0.2)


class FourierPath:
    """q(t) = centre + fade(t) sum_k amplitude_k sin(2 pi k t / period + phase_k).

    It starts and ends at rest in the centre (n,) [rad], fading over a quintic, so that no acceleration jumps.
    Amplitudes [rad] and phases [rad] have shape (n, harmonics).
    """

    def __init__(
        self,
        centre_rad: FloatArray,
        amplitude_rad: FloatArray,
        phase_rad: FloatArray,
        period_s: float,
        duration_s: float,
    ) -> None:
        self.centre_rad, self.duration_s = centre_rad, duration_s
        self._amplitude, self._phase = amplitude_rad, phase_rad
        self._rate = math.tau / period_s * np.arange(1, amplitude_rad.shape[1] + 1)

    def at(self, time_s: float) -> JointMotion:
        """Motion `time_s` [s] after the start; at rest before and after."""
        return self._faded(self._rate * time_s + self._phase, *self._fade(time_s))

    def along(self, times_s: FloatArray) -> JointMotion:
        """The motion at many times (m,) [s] at once; its parts have shape (m, n)."""
        fade, rate, spin = np.array([self._fade(time_s) for time_s in times_s.tolist()]).T[..., None]
        return self._faded(times_s[:, None, None] * self._rate + self._phase, fade, rate, spin)

    def _fade(self, time_s: float) -> tuple[float, float, float]:
        """The share of the full motion and its derivatives; the second half fades as the first, backwards."""
        is_first = time_s <= 0.5 * self.duration_s
        since_s = time_s if is_first else self.duration_s - time_s
        fade, rate, spin = quintic(since_s, _FADE_SHARE * self.duration_s)
        return fade, rate if is_first else -rate, spin

    def _faded(
        self, angle: FloatArray, fade: float | FloatArray, rate: float | FloatArray, spin: float | FloatArray
    ) -> JointMotion:
        """The motion at these angles of the harmonics (..., n, harmonics) [rad]."""
        sine, cosine = self._amplitude * np.sin(angle), self._amplitude * np.cos(angle)
        wave, speed, acceleration = sine.sum(axis=-1), cosine @ self._rate, -(sine @ self._rate**2)
        return JointMotion(
            self.centre_rad + fade * wave,
            fade * speed + rate * wave,
            fade * acceleration + 2.0 * rate * speed + spin * wave,
        )


@dataclass(frozen=True)
class ExcitationSettings:
    """What kind of motion is wanted."""

    duration_s: float  # of the whole motion [s]
    period_s: float  # of its slowest part [s]
    amplitude_rad: float = 1.0  # of a joint, if nothing is in the way [rad]
    speed_rad_s: float = 1.5  # of the fastest joint at most [rad/s]


TORQUE_MOTION = ExcitationSettings(duration_s=40.0, period_s=10.0)
GRAVITY_MOTION = ExcitationSettings(duration_s=60.0, period_s=30.0, speed_rad_s=0.4)


def choose_path(
    body: RigidBody,
    bodies: GravityBodies,
    start_rad: FloatArray,
    limits: Limits,
    *,
    settings: ExcitationSettings,
    rng: np.random.Generator,
) -> FourierPath:
    """The most telling of some random paths about the posture that stands highest.

    The most telling has the largest determinant of the normal equations (D-optimal) of gains, offsets,
    friction and tilt. Nothing goes lower than where the arm stands, `start_rad` (n,); equal seeds choose
    the same path.

    InputError: no motion is clear of the ground and inside the limits, or all are too slow to tell.
    """
    floor_m = float(body.heights_m(start_rad)[1:].min())
    low, high = room(limits, _LIMIT_MARGIN_RAD)
    speed = _allowed_speeds(limits, settings)
    centre = highest_posture(body, low, high)
    check_way_up(body, start_rad, centre, limits)
    times = np.linspace(0.0, settings.duration_s, _LOOKS)
    best: tuple[float, FourierPath] | None = None
    for _ in range(_CANDIDATES):
        shape = (
            rng.uniform(0.3, 1.0, (body.joint_count, HARMONICS)),
            rng.uniform(-math.pi, math.pi, (body.joint_count, HARMONICS)),
        )
        for path in _shrinking(centre, shape, settings, (low, high), speed):
            motion = path.along(times)
            each = (JointMotion(*row) for row in zip(*motion, strict=True))
            if is_clear(body, motion.position_rad, floor_m) and overloaded_joint(body, each, limits) is None:
                score = _information(bodies, motion)
                best = (score, path) if best is None or score > best[0] else best
                break
    if best is None:
        raise InputError(
            "no motion of the arm stays above where it stands now and within its torque limits: "
            "raise the arm first, or limits.torque_nm"
        )
    return best[1]


def _allowed_speeds(limits: Limits, settings: ExcitationSettings) -> FloatArray:
    """Speeds (n,) [rad/s]; refuses with `InputError` a joint too slow for its torque to say anything."""
    speed = paced(settings.speed_rad_s, limits)
    joint = int(speed.argmin())
    if speed[joint] < _SLOWEST_RAD_S:
        raise InputError(
            f"limits.velocity_rad_s of joint {joint + 1} is {limits.velocity_rad_s[joint]:g} rad/s: too slow "
            f"to tell friction from weight; this motion needs {_SLOWEST_RAD_S / SHARE:g} rad/s or more"
        )
    return speed


def _shrinking(
    centre: FloatArray,
    shape: tuple[FloatArray, FloatArray],
    settings: ExcitationSettings,
    bounds: tuple[FloatArray, FloatArray],
    speed: FloatArray,
) -> Iterator[FourierPath]:
    """One path, smaller and smaller; each inside the limits of position and speed."""
    (low, high), (amplitude, phase) = bounds, shape
    period_s = settings.period_s
    times = np.linspace(0.0, settings.duration_s, 10 * _LOOKS)
    unit = FourierPath(np.zeros(len(centre)), amplitude, phase, period_s, settings.duration_s)
    motion = unit.along(times)
    reach, rate = np.abs(motion.position_rad).max(axis=0), np.abs(motion.velocity_rad_s).max(axis=0)
    room = np.minimum(np.minimum(high - centre, centre - low), settings.amplitude_rad)
    scale = np.minimum(room / reach, speed / rate)
    for share in _SHRINKING:
        yield FourierPath(centre, share * scale[:, None] * amplitude, phase, period_s, settings.duration_s)


def _information(bodies: GravityBodies, motion: JointMotion) -> float:
    columns = design(bodies, *motion)
    norms = np.linalg.norm(columns, axis=0)
    sign, size = np.linalg.slogdet(columns[:, norms > 0].T @ columns[:, norms > 0])
    return float(size) if sign > 0 else -math.inf
