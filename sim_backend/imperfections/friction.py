"""Friction in a joint."""

from abc import ABC, abstractmethod
from math import exp
from typing import Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number, Positive
from sim_backend.channel_effect import JointFriction, JointTorque
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale, joint_of


class _Friction(JointImperfection, ABC):
    """A resistance against the motion of one joint; at rest it holds until more than that pulls."""

    def effects(self, joint_count: int) -> Effects:
        return Effects(friction=(JointFriction(self.index_in(joint_count), self.resistance_nm),))

    @abstractmethod
    def resistance_nm(self, speed_rad_s: float, along_nm: float) -> float:
        """The largest resistance [N m], see `JointFriction`."""


class ViscousFriction(_Friction):
    """tau = b |dq/dt| against the motion: grease (Armstrong-Helouvry, Automatica 30 (1994), sec. 2)."""

    name = "viscous_friction"
    viscous_nms_rad: NotNegative = parameter("N m s/rad", 0.02, 5.0, le=100.0)  # b [N m s/rad]

    def resistance_nm(self, speed_rad_s: float, along_nm: float) -> float:
        return self.viscous_nms_rad * speed_rad_s

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        unit = scale.joint_noise_nm / scale.joint(channel).speed_rad_s
        return cls(joint=joint_of(channel), viscous_nms_rad=strength * unit)


class QuadraticFriction(_Friction):
    """tau = b2 (dq/dt)^2 against the motion: churned oil, air.

    Drag at large Reynolds numbers; Batchelor, "An Introduction to Fluid Dynamics", 1967, sec. 5.11.
    """

    name = "quadratic_friction"
    quadratic_nms2_rad2: NotNegative = parameter("N m s^2/rad^2", 0.05, 20.0, le=1000.0)  # b2 [N m s^2/rad^2]

    def resistance_nm(self, speed_rad_s: float, along_nm: float) -> float:
        return self.quadratic_nms2_rad2 * speed_rad_s * speed_rad_s

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        unit = scale.joint_noise_nm / (1.2 * scale.joint(channel).speed_rad_s ** 2)
        return cls(joint=joint_of(channel), quadratic_nms2_rad2=strength * unit)


class CoulombFriction(_Friction):
    """tau = f against the motion; a joint at rest stays there until more than f pulls at it.

    Coulomb 1785; Armstrong-Helouvry et al., Automatica 30 (1994), sec. 2.
    """

    name = "coulomb_friction"
    coulomb_nm: NotNegative = parameter("N m", 0.02, 2.0, le=100.0)  # f [N m]

    def resistance_nm(self, speed_rad_s: float, along_nm: float) -> float:
        return self.coulomb_nm

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at most what a controller masters that does not know it."""
        coulomb_nm = min(strength * scale.joint_noise_nm, scale.joint(channel).mastered_nm)
        return cls(joint=joint_of(channel), coulomb_nm=coulomb_nm)


class AsymmetricFriction(_Friction):
    """tau = f+ against positive and f- against negative motion: a seal, a cable, a worm gear.

    The same as Coulomb friction of (f+ + f-)/2 beside a constant torque of -(f+ - f-)/2, at rest too.
    Armstrong-Helouvry, "Control of Machines with Friction", 1991, sec. 2.
    """

    name = "asymmetric_friction"
    positive_nm: NotNegative = parameter("N m", 0.0, 2.0, le=100.0)  # f+ [N m]
    negative_nm: NotNegative = parameter("N m", 0.0, 2.0, le=100.0)  # f- [N m]

    def effects(self, joint_count: int) -> Effects:
        constant_nm = -0.5 * (self.positive_nm - self.negative_nm)
        constant = JointTorque(self.index_in(joint_count), lambda _position, _drive: constant_nm)
        return super().effects(joint_count) + Effects(joint=(constant,))

    def resistance_nm(self, speed_rad_s: float, along_nm: float) -> float:
        return 0.5 * (self.positive_nm + self.negative_nm)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at most what a controller masters that does not know it."""
        large_nm = min(1.3 * strength * scale.joint_noise_nm, scale.joint(channel).mastered_nm)
        small_nm = generator.uniform(0.1, 0.5) * large_nm
        positive_nm, negative_nm = generator.permutation([large_nm, small_nm]).tolist()
        return cls(joint=joint_of(channel), positive_nm=positive_nm, negative_nm=negative_nm)


class StribeckFriction(_Friction):
    """tau = f + s exp(-(|dq/dt| / v_s)^2) against the motion: the film of grease carries from v_s on.

    Bo and Pavelescu, Wear 82 (1982), with the exponent 2; Armstrong-Helouvry et al., Automatica 30 (1994).
    """

    name = "stribeck_friction"
    # s, how much more at rest than sliding [N m].
    stiction_nm: NotNegative = parameter("N m", 0.02, 2.0, le=100.0)
    speed_rad_s: Positive = parameter("rad/s", 0.01, 0.5, ge=1e-4, le=10.0)  # v_s [rad/s]
    # f, what is left at speed [N m].
    coulomb_nm: NotNegative = parameter("N m", 0.0, 2.0, le=100.0, default=0.0)

    def resistance_nm(self, speed_rad_s: float, along_nm: float) -> float:
        slowness = speed_rad_s / self.speed_rad_s
        return self.coulomb_nm + self.stiction_nm * exp(-slowness * slowness)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at most what a controller masters that does not know it."""
        joint = scale.joint(channel)
        return cls(
            joint=joint_of(channel),
            stiction_nm=min(strength * scale.joint_noise_nm / 0.4, joint.mastered_nm),
            speed_rad_s=generator.uniform(0.2, 0.6) * joint.speed_rad_s,
        )


class LoadDependentFriction(_Friction):
    """tau = mu |tau_load| against the motion: teeth that are pressed together.

    A gear's load-dependent loss; Hamon, Gautier and Garrec, IEEE/RSJ IROS 2010, "Dynamic identification of
    robots with a dry friction model depending on load and velocity". The load is what the gear passes on to
    the link, for its dynamics and for external forces: the drive's torque less the friction.
    """

    name = "load_dependent_friction"
    shows_in = LOADED  # a tool that hangs straight down does not load its joint
    load_share: Number = parameter("-", 0.005, 0.3, ge=0, le=0.9)  # mu [-]

    def resistance_nm(self, speed_rad_s: float, along_nm: float) -> float:
        """A drive that pushes on bears the friction too; one that holds back is helped by it."""
        side = 1.0 if along_nm >= 0.0 else -1.0
        return self.load_share * abs(along_nm) / (1.0 + side * self.load_share)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        share = strength * scale.joint_noise_nm / scale.joint(channel).load_nm
        return cls(joint=joint_of(channel), load_share=min(share, 0.9))
