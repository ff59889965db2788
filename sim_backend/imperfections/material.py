"""An object whose force depends otherwise on depth and rate than its law says."""

from abc import ABC, abstractmethod
from typing import Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number
from sim_backend.hooks import ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class _Material(ContactImperfection, ABC):
    """A force on top of the object's own law, below the surface."""

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Added(self),))

    @abstractmethod
    def added_n(self, depth_m: float, rate_m_s: float) -> float:
        """The force [N] at a depth [m] above 0 and its rate [m/s]."""


class _Added(MaterialEffect):
    def __init__(self, material: _Material) -> None:
        self._material = material

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        if state.depth_m <= 0.0:
            return force_n
        return force_n + self._material.added_n(state.depth_m, state.rate_m_s)


class CubicStiffness(_Material):
    """F += k3 x^3 at depth x (Duffing's spring; Nayfeh and Mook, "Nonlinear Oscillations", 1979, ch. 4)."""

    name = "cubic_stiffness"
    # k3, negative where the object softens [N/m^3].
    cubic_n_m3: Number = parameter("N/m^3", 1e4, 1e7, ge=-1e9, le=1e12)

    def added_n(self, depth_m: float, rate_m_s: float) -> float:
        return self.cubic_n_m3 * depth_m * depth_m * depth_m

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        left = scale.depth_left(strength, 0.09)
        return cls(cubic_n_m3=(1.0 - left) * scale.force_n / (left * scale.depth_m) ** 3)


class LayeredStiffness(_Material):
    """F += k2 (x - d) from depth d on: a second spring is reached there, as bone under tissue.

    Piecewise linear stiffness; Shaw and Holmes, J. Sound Vib. 90 (1983).
    """

    name = "layered_stiffness"
    # k2, what the second layer adds [N/m].
    stiffness_n_m: Number = parameter("N/m", 50.0, 5000.0, ge=0, le=1e6)
    depth_m: NotNegative = parameter("m", 0.001, 0.05, le=1.0)  # d, where it is reached [m]

    def added_n(self, depth_m: float, rate_m_s: float) -> float:
        return self.stiffness_n_m * max(depth_m - self.depth_m, 0.0)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        left, share = scale.depth_left(strength, 0.06), generator.uniform(0.35, 0.6)
        reached_m = left * scale.depth_m
        return cls(
            stiffness_n_m=(1.0 - left) * scale.force_n / ((1.0 - share) * reached_m),
            depth_m=share * reached_m,
        )


class HuntCrossley(_Material):
    """F += (k + b dx/dt) x^n at depth x: nothing at touch, more and more on the way in.

    Hunt and Crossley, J. Appl. Mech. 42 (1975), eq. 2; on top of the object's own law.
    """

    name = "hunt_crossley"
    damping: Number = parameter("N s/m^(n+1)", 100.0, 1e4, ge=0, le=1e9, default=0.0)  # b [N s/m^(n+1)]
    stiffness: Number = parameter("N/m^n", 100.0, 1e4, ge=0, le=1e9, default=0.0)  # k [N/m^n]
    exponent: Number = parameter("-", 1.0, 2.5, ge=1, le=4, default=1.5)  # n [-]

    def added_n(self, depth_m: float, rate_m_s: float) -> float:
        return (self.stiffness + self.damping * rate_m_s) * float(depth_m**self.exponent)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        unit = scale.contact_noise_n / (0.2 * scale.depth_m**1.5 * scale.speed_m_s)
        return cls(damping=strength * unit, exponent=1.5)


class QuadraticDamping(_Material):
    """F += c2 v |v| below the surface, v the rate of depth: a fluid that is pushed out through pores.

    Turbulent drag; Forchheimer's term in Bear, "Dynamics of Fluids in Porous Media", 1972, sec. 5.11.
    """

    name = "quadratic_damping"
    damping_n_s2_m2: Number = parameter("N s^2/m^2", 10.0, 1000.0, ge=0, le=5000)  # c2 [N s^2/m^2]

    def added_n(self, depth_m: float, rate_m_s: float) -> float:
        return self.damping_n_s2_m2 * rate_m_s * abs(rate_m_s)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(damping_n_s2_m2=strength * scale.contact_noise_n / (0.7 * scale.speed_m_s**2))


class ContactOffset(ContactImperfection):
    """The object feels x + d: its surface is higher than the scenario says by d.

    Seen only by those who take the surface as given; a probing run that finds it by touch does not.
    """

    name = "contact_offset"
    shows_in = ()
    needs_force_law = True
    offset_m: Number = parameter("m", -0.005, 0.005, ge=-0.5, le=0.5)  # d [m]

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Higher(self.offset_m),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; here for a surface that is taken as given."""
        sign = generator.choice([-1.0, 1.0])
        return cls(offset_m=sign * strength * scale.contact_noise_n * scale.depth_m / scale.force_n)


class _Higher(MaterialEffect):
    def __init__(self, offset_m: float) -> None:
        self._offset_m = offset_m

    def felt(self, state: ContactState) -> ContactState:
        return state._replace(depth_m=state.depth_m + self._offset_m)
