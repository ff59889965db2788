"""Friction between tip and object that does not depend on speed."""

from math import exp
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number
from sim_backend.hooks import ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class DryFriction(ContactImperfection):
    """F += z, dz/abs(dx) = (f sign(dx) - z) / s: against the motion, full after a way of a few s.

    Dahl's model, "Solid friction damping of mechanical vibrations", AIAA J. 14 (1976): rate-independent
    hysteresis. It is integrated exactly over each step, so that no stiffness f / s can make it unstable.
    """

    name: ClassVar[str] = "dry_friction"
    friction_n: NotNegative = parameter("N", 0.05, 3.0, le=50.0)  # f [N]
    # s, way in which the bristles give way [m].
    slip_m: Number = parameter("m", 2e-5, 1e-3, ge=1e-6, le=0.1, default=2e-4)

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Bristles(self.friction_n, self.slip_m),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(friction_n=strength * scale.contact_noise_n / 0.5, slip_m=0.01 * scale.depth_m)


class _Bristles(MaterialEffect):
    def __init__(self, friction_n: float, slip_m: float) -> None:
        self._friction_n = friction_n
        self._slip_m = slip_m
        self._depth_m = self._tried_depth_m = 0.0
        self._force_n = self._tried_force_n = 0.0

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        self._tried_depth_m = depth_m = max(state.depth_m, 0.0)
        way_m = depth_m - self._depth_m
        full_n = self._friction_n if way_m > 0.0 else -self._friction_n
        bent_n = full_n + (self._force_n - full_n) * exp(-abs(way_m) / self._slip_m)
        self._tried_force_n = bent_n if depth_m else 0.0
        return force_n + self._tried_force_n

    def settle(self) -> None:
        self._depth_m, self._force_n = self._tried_depth_m, self._tried_force_n
