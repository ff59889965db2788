"""Hunt-Crossley made linear by its logarithm."""

import math

import numpy as np

from estimation.contact_estimator import ContactLaw, OnlineContactLaw
from estimation.estimator import OnlineEstimator
from estimation.estimators.ewrls import Ewrls

LEAST_LOAD_N = 0.05  # below this the logarithm is mostly noise
_MOST_LOG = 50.0  # of a gain: a number still


class LogLinear(OnlineContactLaw):
    """ln F = ln k + n ln d + (b / k) v, by any linear estimator.

    Right for b v / k and a noise over the force that are both far below 1: the logarithm of 1 + b v / k is
    taken for b v / k, and that of a noisy force has a mean of its own.

    Args:
        linear: finds ln k, n and b / k.
    """

    def __init__(self, linear: OnlineEstimator) -> None:
        self._linear = linear
        self.start()

    def start(self) -> None:
        self._linear.start(3)

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        if depth_m <= 0.0 or force_n < LEAST_LOAD_N:
            return None
        row = np.array([1.0, math.log(depth_m), speed_m_s])
        log_k, n, ratio = self._linear.update(row, math.log(force_n)).tolist()
        k = math.exp(min(log_k, _MOST_LOG))
        return ContactLaw(k, ratio * k, n, n)


class LogLinearEwrls(LogLinear):
    """The same by exponentially weighted recursive least squares; `forgetting` as for `Ewrls`.

    Source: A. Haddadi, K. Hashtrudi-Zaad, Real-Time Identification of Hunt-Crossley Dynamic Models of Contact
    Environments, IEEE Trans. Robotics 28 (2012).
    """

    name = "log_linear_ewrls"

    def __init__(self, forgetting: float = 0.9995) -> None:
        super().__init__(Ewrls(forgetting))
