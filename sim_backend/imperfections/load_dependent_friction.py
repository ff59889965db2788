"""Friction that grows with the load on a gear."""

from collections.abc import Sequence
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.hooks import Effects, FrictionEffect, JointState
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale, joint_of


class LoadDependentFriction(JointImperfection):
    """tau = mu |tau_load| against the motion: teeth that are pressed together.

    A gear's load-dependent loss; Hamon, Gautier and Garrec, IEEE/RSJ IROS 2010, "Dynamic identification of
    robots with a dry friction model depending on load and velocity". The load is what the gear passes on to
    the link, for its dynamics and for external forces: the drive's torque less the friction.
    """

    name: ClassVar[str] = "load_dependent_friction"
    shows_in: ClassVar[Sequence[str]] = LOADED  # a tool that hangs straight down does not load its joint
    load_share: Number = parameter("-", 0.005, 0.3, ge=0, le=0.9)  # mu [-]

    def effects(self, joint_count: int) -> Effects:
        return Effects(friction=(_Gear(self.index_in(joint_count), self.load_share),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        share = strength * scale.joint_noise_nm / scale.joint(channel).load_nm
        return cls(joint=joint_of(channel), load_share=min(share, 0.9))


class _Gear(FrictionEffect):
    def __init__(self, index: int, share: float) -> None:
        self._index = index
        self._share = share

    def friction_nm(self, state: JointState, limit_nm: Sequence[float]) -> Sequence[float]:
        """A drive that pushes on bears the friction too; one that holds back is helped by it."""
        i, changed = self._index, list(limit_nm)
        drive_nm = state.drive_torque_nm[i]
        side = 1.0 if drive_nm * state.velocity_rad_s[i] >= 0.0 else -1.0
        changed[i] += self._share * abs(drive_nm) / (1.0 + side * self._share)
        return changed
