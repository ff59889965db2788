"""A motor constant that is not what the drive believes."""

from typing import ClassVar, Self

import numpy as np

from robot_io.files.file_model import Number
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.joint_effects import JointTorque
from sim_backend.noise_scale import LOADED, NoiseScale, joint_of


class TorqueGain(JointImperfection):
    """tau_link = g tau_drive: the drive sets and measures current, and takes a wrong constant.

    The measured torque follows the command; what reaches the link does not.

    Attributes:
        joint: which joint, from 1 at the base.
        gain: g, true over believed motor constant; one is right [-].
    """

    name: ClassVar[str] = "torque_gain"

    gain: Number = parameter("-", 0.8, 1.2, ge=0.2, le=3.0)

    def effects(self, joint_count: int) -> Effects:
        """See `Imperfection.effects`."""
        excess = self.gain - 1.0
        index = self.index_in(joint_count)
        return Effects(joint=(JointTorque(index, lambda _position, drive: excess * drive),))

    @classmethod
    def can_show_in(cls, channel: str) -> bool:
        """See `Imperfection.can_show_in`; a tool that hangs straight down does not load its joint."""
        return channel in LOADED

    @classmethod
    def at_strength(
        cls, strength: float, channel: str, scale: NoiseScale, generator: np.random.Generator
    ) -> Self:
        """See `Imperfection.at_strength`."""
        excess = strength * scale.joint_noise_nm / scale.joint(channel).load_nm
        gain = float(np.clip(1.0 + generator.choice([-1.0, 1.0]) * excess, 0.5, 2.0))
        return cls(joint=joint_of(channel), gain=gain)
