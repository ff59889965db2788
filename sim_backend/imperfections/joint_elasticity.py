"""A transmission that twists."""

from collections.abc import Sequence
from math import exp
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.hooks import Effects, JointEffect, JointState, SensorEffect
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import CONTACT, NoiseScale, channel_of, joint_of


class JointElasticity(JointImperfection):
    """The encoder, on the drive's side, is ahead of the link by the twist u of a spring that carries tau.

    T du/dt = C tau - u: spring and dashpot in parallel, between the link and a drive without inertia of its
    own, which lets the whole torque through. It is the slow part of Spong's model (J. Dyn. Sys. Meas. Control
    109, 1987); the rotor's inertia is counted to the link, as the URDF does.
    """

    name: ClassVar[str] = "joint_elasticity"
    shows_in: ClassVar[Sequence[str]] = ()  # in probing, the twist is mostly that of the steady weight
    # C, one over the stiffness; zero is rigid [rad/(N m)].
    compliance_rad_nm: NotNegative = parameter("rad/(N m)", 5e-5, 2e-3, le=0.05)
    # T, damping over stiffness [s].
    retardation_s: NotNegative = parameter("s", 0.005, 0.1, le=10.0, default=0.02)

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; the tip is not where the encoders say."""
        return (channel_of(self.joint), CONTACT)

    def effects(self, joint_count: int) -> Effects:
        shaft = _Shaft(self.index_in(joint_count), self.compliance_rad_nm, self.retardation_s)
        return Effects(joint=(shaft,), encoder=(shaft,))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; as soft as can still be controlled by the encoder at most."""
        compliance_rad_nm = strength * scale.joint_noise_nm / (25.0 * scale.joint(channel).load_nm)
        return cls(joint=joint_of(channel), compliance_rad_nm=min(compliance_rad_nm, 2e-3))


class _Shaft(JointEffect, SensorEffect):
    def __init__(self, index: int, compliance_rad_nm: float, retardation_s: float) -> None:
        self._index = index
        self._compliance_rad_nm = compliance_rad_nm
        self._retardation_s = retardation_s
        self.restart()

    def restart(self) -> None:
        self._twist_rad = 0.0

    def joint_torque_nm(self, state: JointState, torque_nm: Sequence[float]) -> Sequence[float]:
        left = exp(-state.step_s / self._retardation_s) if self._retardation_s else 0.0
        settled_rad = self._compliance_rad_nm * torque_nm[self._index]
        self._twist_rad = settled_rad + left * (self._twist_rad - settled_rad)
        return torque_nm

    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        changed = list(value)
        changed[self._index] += self._twist_rad
        return changed
