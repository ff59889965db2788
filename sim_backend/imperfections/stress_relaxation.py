"""Force that fades while the depth is held."""

from math import exp
from typing import ClassVar, Self

import numpy as np
from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.hooks import ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class StressRelaxation(ContactImperfection):
    """F += sum of F_i, dF_i/dt = k_i dx/dt - F_i / tau_i: one or two Maxwell branches beside the spring.

    The generalised Maxwell (Wiechert) solid; Ferry, "Viscoelastic Properties of Polymers", 1980, ch. 1. The
    object's own spring is what is left in the end. The branches go on relaxing when the tip has left.
    """

    name: ClassVar[str] = "stress_relaxation"
    stiffness_n_m: Number = parameter("N/m", 20.0, 2000.0, ge=0, le=1e6)  # k_1 [N/m]
    time_s: Number = parameter("s", 0.02, 2.0, ge=1e-3, le=1e3)  # tau_1 [s]
    # k_2; zero for one branch only [N/m].
    second_stiffness_n_m: Number = parameter("N/m", 0.0, 2000.0, ge=0, le=1e6, default=0.0)
    second_time_s: Number = parameter("s", 0.02, 2.0, ge=1e-3, le=1e3, default=1.0)  # tau_2 [s]

    def effects(self, joint_count: int) -> Effects:
        branches = [_MaxwellBranch(self.stiffness_n_m, self.time_s)]
        if self.second_stiffness_n_m:
            branches.append(_MaxwellBranch(self.second_stiffness_n_m, self.second_time_s))
        return Effects(contact=tuple(branches))

    def values(self) -> dict[str, tuple[float, str]]:
        """See `Imperfection.values`; a second branch only where there is one."""
        return {
            name: value
            for name, value in super().values().items()
            if self.second_stiffness_n_m or not name.startswith("second_")
        }

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(
            stiffness_n_m=strength * scale.contact_noise_n / (0.08 * scale.depth_m),
            time_s=float(np.exp(generator.uniform(np.log(0.08), np.log(0.5)))),
        )


class _MaxwellBranch(MaterialEffect):
    """Exact for a depth that changes at a constant rate within the step."""

    def __init__(self, stiffness_n_m: float, time_s: float) -> None:
        self._stiffness_n_m = stiffness_n_m
        self._time_s = time_s
        self._depth_m = self._tried_depth_m = 0.0
        self._force_n = self._tried_force_n = 0.0

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        depth_m = state.depth_m if state.depth_m > 0.0 else 0.0
        steps = state.step_s / self._time_s
        fade = exp(-steps)
        stretch_m = depth_m - self._depth_m
        self._tried_depth_m = depth_m
        self._tried_force_n = fade * self._force_n + self._stiffness_n_m * stretch_m * (1.0 - fade) / steps
        return force_n + self._tried_force_n if depth_m else force_n

    def settle(self) -> None:
        self._depth_m, self._force_n = self._tried_depth_m, self._tried_force_n
