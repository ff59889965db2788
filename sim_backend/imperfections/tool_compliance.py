"""A tool that gives way."""

from collections.abc import Callable
from typing import Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.hooks import ContactState, Effects, ToolEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale

_EXACT_N = 1e-9
_EXACT_M = 1e-15
_MOST_TRIES = 60
_RIGID_M_N = 1e-12


class ToolCompliance(ContactImperfection):
    """A spring in series: the tool is compressed by u = C F, and the object feels x - u at the rate of x - u.

    Both springs carry the same force, which is solved for at each physics step.
    """

    name = "tool_compliance"
    shows_in = ()  # by itself it is a softer object
    needs_force_law = True
    # C, one over the tool's stiffness; zero is rigid [m/N].
    compliance_m_n: NotNegative = parameter("m/N", 1e-5, 1e-3, le=0.01)

    def effects(self, joint_count: int) -> Effects:
        gives_way = self.compliance_m_n > _RIGID_M_N
        return Effects(tool=(_SeriesSpring(self.compliance_m_n),)) if gives_way else Effects()

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; here of what would pass for a softer object."""
        squeeze_m = strength * scale.contact_noise_n * scale.depth_m / scale.force_n
        return cls(compliance_m_n=squeeze_m / scale.force_n)


class _SeriesSpring(ToolEffect):
    """Solves u = C S(x - u, dx/dt - du/dt) for u, where S is the object's answer.

    S grows with depth and rate, so that S(u) - u / C falls with u, and the root lies between nothing and what
    the object would answer to a rigid tool. Regula falsi with the Illinois rule (Dowell and Jarratt, BIT 11,
    1971) cannot leave that bracket where S jumps; begun at the root of the last step's secant, it is there at
    once where S is linear.
    """

    def __init__(self, compliance_m_n: float) -> None:
        self._stiffness_n_m = 1.0 / compliance_m_n
        self._squeeze_m = self._tried_squeeze_m = 0.0
        self._slope_n_m = 0.0  # of S(u), by the last step's secant

    def contact_force_n(self, state: ContactState, surface_n: Callable[[ContactState], float]) -> float:
        stiffness, before_m = self._stiffness_n_m, self._squeeze_m
        time_s, step_s, depth_m, rate_m_s = state

        def left_n(squeeze_m: float) -> float:
            rate = rate_m_s - (squeeze_m - before_m) / step_s
            answer_n = surface_n(ContactState(time_s, step_s, depth_m - squeeze_m, rate))
            return answer_n - stiffness * squeeze_m

        rigid_n = left_n(0.0)
        squeeze_m = self._root(left_n, rigid_n) if rigid_n else 0.0
        self._tried_squeeze_m = squeeze_m
        return stiffness * squeeze_m

    def _root(self, left_n: Callable[[float], float], rigid_n: float) -> float:
        """Where the balance `left_n` is zero, given that of no squeeze; the last one asked for [m]."""
        near_m, near_n = 0.0, rigid_n
        far_m = rigid_n / (self._stiffness_n_m - self._slope_n_m)
        far_n = left_n(far_m)
        if far_n * rigid_n > 0.0:  # not far enough
            near_m, near_n, far_m = far_m, far_n, rigid_n / self._stiffness_n_m
            far_n = left_n(far_m)
        for _ in range(_MOST_TRIES):
            if abs(far_n) < _EXACT_N or abs(far_m - near_m) < _EXACT_M:
                break
            squeeze_m = (near_m * far_n - far_m * near_n) / (far_n - near_n)
            now_n = left_n(squeeze_m)
            if now_n * far_n < 0.0:
                near_m, near_n = far_m, far_n
            else:
                near_n *= 0.5
            far_m, far_n = squeeze_m, now_n
        self._slope_n_m = min((far_n - rigid_n) / far_m + self._stiffness_n_m, 0.0)
        return far_m

    def settle(self) -> None:
        self._squeeze_m = self._tried_squeeze_m
