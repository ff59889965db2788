"""Kelvin-Voigt and Hunt-Crossley side by side, and a switch."""

import numpy as np

from estimation.contact_estimator import ContactLaw, OnlineContactLaw
from estimation.contact_estimators.log_linear_ewrls import LogLinear
from estimation.estimators.sprls import Sprls

_HYSTERESIS = 1.1


class HybridSprls(OnlineContactLaw):
    """Two self-perturbing recursive least squares, one a law; a stiff object is given the linear one.

    Source: A. Pappalardo, A. Albakri, C. Liu, L. Bascetta, E. De Momi, P. Poignet, Hunt-Crossley Model Based
    Force Control for Minimally Invasive Robotic Surgery, Biomed. Signal Proc. Control 29 (2016).

    Args:
        switch_n_m: stiffness that Kelvin-Voigt finds, above which its law is the answer [N/m].
        beta: as for `Sprls`.
        gamma: as for `Sprls`, per squared newton for Kelvin-Voigt; the logarithm of a force has no unit and
            is perturbed by a change of the force by more than a factor of two alone.
    """

    name = "hybrid_sprls"

    def __init__(self, switch_n_m: float = 1000.0, beta: float = 20.0, gamma: float = 1.0) -> None:
        self._switch_n_m = switch_n_m
        self._linear = Sprls(beta, gamma)
        self._power = LogLinear(Sprls(beta, gamma))
        self.start()

    def start(self) -> None:
        self._linear.start(2)
        self._power.start()
        self._is_stiff = False

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        stiffness, damping = self._linear.update(np.array([depth_m, speed_m_s]), force_n).tolist()
        power = self._power.update(depth_m, speed_m_s, force_n)
        self._is_stiff = stiffness > (self._switch_n_m / _HYSTERESIS if self._is_stiff else self._switch_n_m)
        return ContactLaw(stiffness, damping) if self._is_stiff else power
