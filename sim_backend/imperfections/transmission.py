"""What lies between a drive, whose side the encoder sees, and its link."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import exp
from typing import Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Positive
from sim_backend.hooks import Effects, JointEffect, JointState, SensorEffect
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import CONTACT, NoiseScale, channel_of, joint_of


class _Transmission(JointImperfection, ABC):
    """The encoder is ahead of the link by u, while the whole torque passes through.

    The drive has no inertia of its own here: the rotor's is counted to the link, as the URDF does.
    """

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; the tip is not where the encoders say."""
        return (channel_of(self.joint), CONTACT)

    def effects(self, joint_count: int) -> Effects:
        ahead = _Ahead(self.index_in(joint_count), self)
        return Effects(joint=(ahead,), encoder=(ahead,))

    @abstractmethod
    def ahead_rad(self, before_rad: float, step_s: float, torque_nm: float) -> float:
        """How far the encoder is ahead after a step with this torque, given how far it was before [rad]."""


class _Ahead(JointEffect, SensorEffect):
    def __init__(self, index: int, transmission: _Transmission) -> None:
        self._index = index
        self._transmission = transmission
        self.restart()

    def restart(self) -> None:
        self._ahead_rad = 0.0

    def joint_torque_nm(self, state: JointState, torque_nm: Sequence[float]) -> Sequence[float]:
        self._ahead_rad = self._transmission.ahead_rad(self._ahead_rad, state.step_s, torque_nm[self._index])
        return torque_nm

    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        changed = list(value)
        changed[self._index] += self._ahead_rad
        return changed


class Backlash(_Transmission):
    """The encoder, on the drive's side, is ahead of the link by u within +- gap/2, on the side that pushes.

    The drive crosses the gap when the torque changes sign, du/dt = tau / d, held up by the grease: the
    physical model of Nordin and Gutman, Automatica 38 (2002), with a shaft that only damps.
    """

    name = "backlash"
    shows_in = ()  # in probing, weight keeps the play on one side
    gap_rad: NotNegative = parameter("rad", 2e-4, 0.01, le=0.2)  # from one flank to the other [rad]
    # d, of the grease in the gap [N m s/rad].
    film_nms_rad: Positive = parameter("N m s/rad", 1.0, 100.0, ge=0.1, le=1e4, default=10.0)

    def ahead_rad(self, before_rad: float, step_s: float, torque_nm: float) -> float:
        reach_rad = 0.5 * self.gap_rad
        return max(-reach_rad, min(reach_rad, before_rad + step_s * torque_nm / self.film_nms_rad))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; here of what a controller does about the gap that it sees."""
        stiffness_nm_rad = 3600.0 * scale.joint(channel).inertia_kg_m2
        gap_rad = strength * scale.joint_noise_nm / stiffness_nm_rad
        return cls(joint=joint_of(channel), gap_rad=min(gap_rad, 0.02))


class JointElasticity(_Transmission):
    """The encoder, on the drive's side, is ahead of the link by the twist u of a spring that carries tau.

    T du/dt = C tau - u: spring and dashpot in parallel. It is the slow part of Spong's model (J. Dyn. Sys.
    Meas. Control 109, 1987).
    """

    name = "joint_elasticity"
    shows_in = ()  # in probing, the twist is mostly that of the steady weight
    # C, one over the stiffness; zero is rigid [rad/(N m)].
    compliance_rad_nm: NotNegative = parameter("rad/(N m)", 5e-5, 2e-3, le=0.05)
    # T, damping over stiffness [s].
    retardation_s: NotNegative = parameter("s", 0.005, 0.1, le=10.0, default=0.02)

    def ahead_rad(self, before_rad: float, step_s: float, torque_nm: float) -> float:
        left = exp(-step_s / self.retardation_s) if self.retardation_s else 0.0
        settled_rad = self.compliance_rad_nm * torque_nm
        return settled_rad + left * (before_rad - settled_rad)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; as soft as can still be controlled by the encoder at most."""
        compliance_rad_nm = strength * scale.joint_noise_nm / (25.0 * scale.joint(channel).load_nm)
        return cls(joint=joint_of(channel), compliance_rad_nm=min(compliance_rad_nm, 2e-3))
