"""A motion of all joints that excites what is to be identified: a finite Fourier series about a posture.

J. Swevers et al., Optimal robot excitation and identification, IEEE Trans. Robotics Automation 13(5), 1997.
"""

import math

import numpy as np

from control.paths.trajectory import JointMotion
from robot_io.types import FloatArray

_FADE_SHARE = 0.1  # of the duration, from rest to the full motion and back


class FourierPath:
    """q(t) = centre + fade(t) sum_k amplitude_k sin(2 pi k t / period + phase_k).

    It starts and ends at rest in the centre. The fade is a quintic, so that no acceleration jumps.

    Args:
        centre_rad: shape (n,) [rad].
        amplitude_rad: shape (n, harmonics) [rad].
        phase_rad: shape (n, harmonics) [rad].
        period_s: of the slowest harmonic [s].
        duration_s: of the whole motion [s].
    """

    def __init__(
        self,
        centre_rad: FloatArray,
        amplitude_rad: FloatArray,
        phase_rad: FloatArray,
        period_s: float,
        duration_s: float,
    ) -> None:
        self.centre_rad = centre_rad
        self.duration_s = duration_s
        self._amplitude = amplitude_rad
        self._phase = phase_rad
        self._rate = math.tau / period_s * np.arange(1, amplitude_rad.shape[1] + 1)

    def at(self, time_s: float) -> JointMotion:
        """Motion `time_s` [s] after the start; at rest before and after."""
        angle = self._rate * time_s + self._phase
        sine, cosine = self._amplitude * np.sin(angle), self._amplitude * np.cos(angle)
        wave = sine.sum(axis=1)
        speed = cosine @ self._rate
        acceleration = -(sine @ self._rate**2)
        fade, rate, spin = self._fade(time_s)
        return JointMotion(
            self.centre_rad + fade * wave,
            fade * speed + rate * wave,
            fade * acceleration + 2.0 * rate * speed + spin * wave,
        )

    def _fade(self, time_s: float) -> tuple[float, float, float]:
        """From 0 to 1 and back, with its derivatives."""
        ramp_s = _FADE_SHARE * self.duration_s
        if time_s > 0.5 * self.duration_s:
            value, rate, spin = _quintic((self.duration_s - time_s) / ramp_s)
            return value, -rate / ramp_s, spin / ramp_s**2
        value, rate, spin = _quintic(time_s / ramp_s)
        return value, rate / ramp_s, spin / ramp_s**2


def _quintic(s: float) -> tuple[float, float, float]:
    if not 0.0 < s < 1.0:
        return float(s > 0.0), 0.0, 0.0
    return (
        s**3 * (10.0 + s * (-15.0 + 6.0 * s)),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )
