"""A motor constant that is not what the drive believes."""

from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np
from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.channel_effect import JointTorque
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale, joint_of


class TorqueGain(JointImperfection):
    """tau_link = g tau_drive: the drive sets and measures current, and takes a wrong constant.

    The measured torque follows the command; what reaches the link does not.
    """

    name: ClassVar[str] = "torque_gain"
    shows_in: ClassVar[Sequence[str]] = LOADED  # a tool that hangs straight down does not load its joint
    # g, true over believed motor constant; one is right [-].
    gain: Number = parameter("-", 0.8, 1.2, ge=0.2, le=3.0)

    def effects(self, joint_count: int) -> Effects:
        excess = self.gain - 1.0
        index = self.index_in(joint_count)
        return Effects(joint=(JointTorque(index, lambda _position, drive: excess * drive),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        excess = strength * scale.joint_noise_nm / scale.joint(channel).load_nm
        gain = float(np.clip(1.0 + generator.choice([-1.0, 1.0]) * excess, 0.5, 2.0))
        return cls(joint=joint_of(channel), gain=gain)
