"""A tool that gives way."""

from collections.abc import Callable
from typing import ClassVar, Self

import numpy as np

from robot_io.file_model import NotNegative
from sim_backend.hooks import ContactState, Effects, ToolEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale

_EXACT_N = 1e-9
_EXACT_M = 1e-15
_MOST_TRIES = 60


class ToolCompliance(ContactImperfection):
    """A spring in series: the tool is compressed by u = C F, and the object feels x - u at the rate of x - u.

    Both springs carry the same force, which is solved for at each physics step.

    Attributes:
        compliance_m_n: C, one over the tool's stiffness; zero is rigid [m/N].
    """

    name: ClassVar[str] = "tool_compliance"
    needs_force_law: ClassVar[bool] = True

    compliance_m_n: NotNegative = parameter("m/N", 1e-5, 1e-3, le=0.01)

    def effects(self, joint_count: int) -> Effects:
        """See `Imperfection.effects`."""
        return Effects(tool=(_SeriesSpring(self.compliance_m_n),)) if self.compliance_m_n else Effects()

    @classmethod
    def can_show_in(cls, channel: str) -> bool:
        """See `Imperfection.can_show_in`; by itself it is a softer object."""
        return False

    @classmethod
    def at_strength(
        cls, strength: float, channel: str, scale: NoiseScale, generator: np.random.Generator
    ) -> Self:
        """See `Imperfection.at_strength`; here of what would pass for a softer object."""
        squeeze_m = strength * scale.contact_noise_n * scale.depth_m / scale.force_n
        return cls(compliance_m_n=squeeze_m / scale.force_n)


class _SeriesSpring(ToolEffect):
    """Solves u = C S(x - u, dx/dt - du/dt) for u, where S is the object's answer.

    S grows with depth and rate, so that C S(u) - u falls with u, and the root lies between nothing and what
    the object would answer to a rigid tool. Regula falsi with the Illinois rule (Dowell and Jarratt, BIT 11,
    1971) needs one secant step where S is linear and cannot leave the bracket where it jumps.
    """

    def __init__(self, compliance_m_n: float) -> None:
        self._compliance_m_n = compliance_m_n
        self._squeeze_m = self._tried_squeeze_m = 0.0

    def contact_force_n(self, state: ContactState, surface_n: Callable[[ContactState], float]) -> float:
        compliance, before_m = self._compliance_m_n, self._squeeze_m
        time_s, step_s, depth_m, rate_m_s = state

        def answer_n(squeeze_m: float) -> float:
            rate = rate_m_s - (squeeze_m - before_m) / step_s
            return surface_n(ContactState(time_s, step_s, depth_m - squeeze_m, rate))

        near_m, near_n = 0.0, answer_n(0.0)  # what is left of the balance at both ends of the bracket
        far_m, squeeze_m = compliance * near_n, 0.0
        far_n = answer_n(far_m) - near_n if far_m else 0.0
        for _ in range(_MOST_TRIES):
            if far_n == near_n:
                break
            squeeze_m = (near_m * far_n - far_m * near_n) / (far_n - near_n)
            left_n = answer_n(squeeze_m) - squeeze_m / compliance
            if abs(left_n) < _EXACT_N or abs(far_m - near_m) < _EXACT_M:
                break
            if left_n * far_n < 0.0:
                near_m, near_n = far_m, far_n
            else:
                near_n *= 0.5
            far_m, far_n = squeeze_m, left_n
        self._tried_squeeze_m = squeeze_m
        return squeeze_m / compliance

    def settle(self) -> None:
        self._squeeze_m = self._tried_squeeze_m
