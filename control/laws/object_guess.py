"""A running guess of the object's stiffness and damping, for the force law to scale itself by.

It is quick rather than right: it is there within milliseconds of touch, and it forgets along the way into the
object, so that it follows a stiffening one. What the object is really like is for the package `estimation`.
"""

import math
from typing import NamedTuple

from robot_io.clip import clip

_STIFFNESS_BOUNDS_N_M = (50.0, 30_000.0)
_DAMPING_BOUNDS_N_S_M = (0.0, 400.0)
_STIFFNESS_SPREAD_N_M = 3000.0  # what is likely before anything is known
_DAMPING_SPREAD_N_S_M = 100.0
_FORCE_NOISE_N = 0.05
_MEMORY_N = 3.0  # the past fades as the spring's force changes by this much
_STILL_M_S = 0.002  # below this speed nothing new is learnt


class Compliance(NamedTuple):
    """Stiffness [N/m] and damping [N s/m] of an object, F = k x + c dx/dt."""

    stiffness_n_m: float
    damping_n_s_m: float


def within_bounds(compliance: Compliance) -> Compliance:
    """The nearest that a force law is stable for."""
    stiffness_n_m, damping_n_s_m = compliance
    return Compliance(
        clip(stiffness_n_m, *_STIFFNESS_BOUNDS_N_M), clip(damping_n_s_m, *_DAMPING_BOUNDS_N_S_M)
    )


class ObjectGuess:
    """Recursive least squares of force = k depth + c speed, with forgetting, in plain floats.

    Ljung and Soderstrom, "Theory and Practice of Recursive Identification", MIT Press 1983, section 2.2.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the object."""
        self._k = self._c = self._p_kc = 0.0
        self._p_kk, self._p_cc = _STIFFNESS_SPREAD_N_M**2, _DAMPING_SPREAD_N_S_M**2

    @property
    def compliance(self) -> Compliance:
        """The guess, within bounds."""
        return within_bounds(Compliance(self._k, self._c))

    def update(self, depth_m: float, speed_m_s: float, force_n: float, dt_s: float) -> None:
        """Learn from one sample: way since the touch, speed into the object, compression."""
        if abs(speed_m_s) < _STILL_M_S:
            return
        gain_k = self._p_kk * depth_m + self._p_kc * speed_m_s
        gain_c = self._p_kc * depth_m + self._p_cc * speed_m_s
        forget = math.exp(-self.compliance.stiffness_n_m * abs(speed_m_s) * dt_s / _MEMORY_N)
        spread = forget * _FORCE_NOISE_N**2 + depth_m * gain_k + speed_m_s * gain_c
        error_n = force_n - self._k * depth_m - self._c * speed_m_s
        self._k += gain_k * error_n / spread
        self._c += gain_c * error_n / spread
        # The spread is kept below what was likely at first, or forgetting would inflate it without end.
        self._p_kk = min((self._p_kk - gain_k**2 / spread) / forget, _STIFFNESS_SPREAD_N_M**2)
        self._p_cc = min((self._p_cc - gain_c**2 / spread) / forget, _DAMPING_SPREAD_N_S_M**2)
        most = math.sqrt(max(self._p_kk * self._p_cc, 0.0))
        self._p_kc = clip((self._p_kc - gain_k * gain_c / spread) / forget, -most, most)
