"""Damping that grows with depth."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.hooks import ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class HuntCrossley(ContactImperfection):
    """F += (k + b dx/dt) x^n at depth x: nothing at touch, more and more on the way in.

    Hunt and Crossley, J. Appl. Mech. 42 (1975), eq. 2; on top of the object's own law.
    """

    name: ClassVar[str] = "hunt_crossley"
    damping: Number = parameter("N s/m^(n+1)", 100.0, 1e4, ge=0, le=1e9, default=0.0)  # b [N s/m^(n+1)]
    stiffness: Number = parameter("N/m^n", 100.0, 1e4, ge=0, le=1e9, default=0.0)  # k [N/m^n]
    exponent: Number = parameter("-", 1.0, 2.5, ge=1, le=4, default=1.5)  # n [-]

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Sphere(self),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        unit = scale.contact_noise_n / (0.2 * scale.depth_m**1.5 * scale.speed_m_s)
        return cls(damping=strength * unit, exponent=1.5)


class _Sphere(MaterialEffect):
    def __init__(self, law: HuntCrossley) -> None:
        self._law = law

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        depth_m, law = state.depth_m, self._law
        if depth_m <= 0.0:
            return force_n
        return force_n + (law.stiffness + law.damping * state.rate_m_s) * float(depth_m**law.exponent)
