"""A Kalman filter on Hunt-Crossley with a known exponent, which learns its noise."""

import numpy as np

from estimation.contact_estimator import ContactLaw, OnlineContactLaw
from robot_io.errors import InputError

_SPREAD = (1e5, 1e5, 3e-4)  # of k, b and the surface before anything is known
_FIRST_NOISE_N = 0.1
_NOISE_MEMORY = 0.99  # of the noise, per sample
_LEAST_NOISE_N = 1e-4
_LEAST_DEPTH_M = 1e-5


class ReducedKalman(OnlineContactLaw):
    """F = (k + b v) (x - s)^n with n from the tool's shape; state k, b and the surface s.

    The reduction of the contact to one dimension gives n = 1 for a flat punch, 1.5 for a ball and 2 for a
    cone, so that only the material is left to find. The variance of the measured force follows the errors,
    less what the state's own spread explains, and that of the state grows by a share each sample.

    Source: L. Beber et al., Towards Robotised Palpation for Cancer Detection through Online Tissue
    Viscoelastic Characterisation with a Collaborative Robotic Arm (2024), arXiv 2404.09542; noise: R. K.
    Mehra, Approaches to Adaptive Filtering, IEEE Trans. Automatic Control 17 (1972).

    Args:
        exponent: n.
        drift: by which share the standard deviation of k and b may change from sample to sample.
    """

    name = "reduced_kalman"

    def __init__(self, exponent: float = 1.5, drift: float = 1e-5) -> None:
        if not exponent > 0.0 or drift < 0.0:
            raise InputError(
                f"reduced_kalman: exponent {exponent} must be positive, drift {drift} not negative"
            )
        self.exponent, self.drift = exponent, drift
        self.start()

    def start(self) -> None:
        self._state = np.zeros(3)
        self._covariance = np.diag(np.square(_SPREAD))
        self._noise2 = _FIRST_NOISE_N**2

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        k, b, surface_m = self._state.tolist()
        deep = max(depth_m - surface_m, _LEAST_DEPTH_M)
        power = deep**self.exponent
        push = k + b * speed_m_s
        row = np.array([power, power * speed_m_s, -push * self.exponent * power / deep])
        spread = self._covariance.dot(row)
        known = float(row.dot(spread))
        error = force_n - push * power
        gain = spread / (known + self._noise2)
        self._state = self._state + gain * error
        self._covariance -= gain[:, None] * spread
        self._covariance[0, 0] += (self.drift * k) ** 2
        self._covariance[1, 1] += (self.drift * b) ** 2
        if known < self._noise2:
            fresh = max(error * error - known, _LEAST_NOISE_N**2)
            self._noise2 += (1.0 - _NOISE_MEMORY) * (fresh - self._noise2)
        k, b, surface_m = self._state.tolist()
        return ContactLaw(k, b, self.exponent, self.exponent, surface_m)
