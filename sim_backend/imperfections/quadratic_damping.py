"""Damping that grows with the square of the speed."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.hooks import ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class QuadraticDamping(ContactImperfection):
    """F += c2 v |v| below the surface, v the rate of depth: a fluid that is pushed out through pores.

    Turbulent drag; Forchheimer's term in Bear, "Dynamics of Fluids in Porous Media", 1972, sec. 5.11.
    """

    name: ClassVar[str] = "quadratic_damping"
    damping_n_s2_m2: Number = parameter("N s^2/m^2", 10.0, 1000.0, ge=0, le=5000)  # c2 [N s^2/m^2]

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Drag(self.damping_n_s2_m2),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(damping_n_s2_m2=strength * scale.contact_noise_n / (0.7 * scale.speed_m_s**2))


class _Drag(MaterialEffect):
    def __init__(self, damping_n_s2_m2: float) -> None:
        self._damping_n_s2_m2 = damping_n_s2_m2

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        rate_m_s = state.rate_m_s
        if state.depth_m <= 0.0:
            return force_n
        return force_n + self._damping_n_s2_m2 * rate_m_s * abs(rate_m_s)
