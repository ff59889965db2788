"""A spring that hardens, or softens, with depth."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.hooks import ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class CubicStiffness(ContactImperfection):
    """F += k3 x^3 at depth x (Duffing's spring; Nayfeh and Mook, "Nonlinear Oscillations", 1979, ch. 4)."""

    name: ClassVar[str] = "cubic_stiffness"
    # k3, negative where the object softens [N/m^3].
    cubic_n_m3: Number = parameter("N/m^3", 1e4, 1e7, ge=-1e9, le=1e12)

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Hardening(self.cubic_n_m3),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        left = scale.depth_left(strength, 0.09)
        return cls(cubic_n_m3=(1.0 - left) * scale.force_n / (left * scale.depth_m) ** 3)


class _Hardening(MaterialEffect):
    def __init__(self, cubic_n_m3: float) -> None:
        self._cubic_n_m3 = cubic_n_m3

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        depth_m = state.depth_m
        return force_n + self._cubic_n_m3 * depth_m * depth_m * depth_m if depth_m > 0.0 else force_n
