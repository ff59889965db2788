"""Hunt-Crossley by two recursive least squares that feed each other."""

import math

import numpy as np

from estimation.contact_estimator import ContactLaw, OnlineContactLaw
from estimation.contact_estimators.log_linear_ewrls import LEAST_LOAD_N
from estimation.estimators.ewrls import Ewrls
from robot_io.errors import InputError

_FIRST_EXPONENT = 1.3
_EXPONENTS = (0.5, 4.0)


class DoubleStageRls(OnlineContactLaw):
    """One stage finds k and b for the exponent of the other, which finds n for those gains.

        F = k d^n + b d^n v,        ln(F / (k + b v)) = n ln d

    It converges if n begins near enough, and slowly: an error of n is made up for by k and b for as long as
    depths are alike.

    Source: N. Diolaiti, C. Melchiorri, S. Stramigioli, Contact Impedance Estimation for Robotic Systems, IEEE
    Trans. Robotics 21 (2005).

    Args:
        forgetting: weight kept by each sample per step, in (0, 1], in both stages.
        exponent: n to begin with.
    """

    name = "double_stage_rls"

    def __init__(self, forgetting: float = 0.995, exponent: float = _FIRST_EXPONENT) -> None:
        if not _EXPONENTS[0] <= exponent <= _EXPONENTS[1]:
            raise InputError(f"double_stage_rls: exponent {exponent} must be within {_EXPONENTS}")
        self._gains = Ewrls(forgetting)
        self._forgetting, self._first_exponent = forgetting, exponent
        self.start()

    def start(self) -> None:
        self._gains.start(2)
        self._exponent = self._first_exponent
        self._information = 1.0  # of n, in sums of squared logarithms

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        if depth_m <= 0.0:
            return None
        power = depth_m**self._exponent
        k, b = self._gains.update(np.array([power, power * speed_m_s]), force_n).tolist()
        push = k + b * speed_m_s
        if force_n > LEAST_LOAD_N and push > 0.0:
            log_depth = math.log(depth_m)
            self._information = self._forgetting * self._information + log_depth**2
            error = math.log(force_n / push) - self._exponent * log_depth
            moved = self._exponent + error * log_depth / self._information
            self._exponent = min(max(moved, _EXPONENTS[0]), _EXPONENTS[1])
        return ContactLaw(k, b, self._exponent, self._exponent)
