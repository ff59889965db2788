"""Friction that grows with the torque that a gear passes on."""

from typing import ClassVar, Self

import numpy as np

from robot_io.files.file_model import Number
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.joint_effects import JointFriction
from sim_backend.noise_scale import LOADED, NoiseScale, joint_of


class LoadDependentFriction(JointImperfection):
    """tau = mu |tau_drive| against the motion: teeth that are pressed together.

    A gear's load-dependent loss; Hamon, Gautier and Garrec, IEEE/RSJ IROS 2010, "Dynamic identification of
    robots with a dry friction model depending on load and velocity". The load is the drive's torque.

    Attributes:
        joint: which joint, from 1 at the base.
        load_share: mu [-].
    """

    name: ClassVar[str] = "load_dependent_friction"

    load_share: Number = parameter("-", 0.005, 0.3, ge=0, le=0.9)

    def effects(self, joint_count: int) -> Effects:
        """See `Imperfection.effects`."""
        share = self.load_share
        return Effects(
            friction=(JointFriction(self.index_in(joint_count), lambda _speed, load: share * load),)
        )

    @classmethod
    def can_show_in(cls, channel: str) -> bool:
        """See `Imperfection.can_show_in`; a tool that hangs straight down does not load its joint."""
        return channel in LOADED

    @classmethod
    def at_strength(
        cls, strength: float, channel: str, scale: NoiseScale, generator: np.random.Generator
    ) -> Self:
        """See `Imperfection.at_strength`."""
        share = strength * scale.joint_noise_nm / scale.joint(channel).load_nm
        return cls(joint=joint_of(channel), load_share=min(share, 0.9))
