"""Friction in proportion to speed."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import JointFriction
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import NoiseScale, joint_of


class ViscousFriction(JointImperfection):
    """tau = b |dq/dt| against the motion: grease (Armstrong-Helouvry, Automatica 30 (1994), sec. 2)."""

    name: ClassVar[str] = "viscous_friction"
    viscous_nms_rad: NotNegative = parameter("N m s/rad", 0.02, 5.0, le=100.0)  # b [N m s/rad]

    def effects(self, joint_count: int) -> Effects:
        viscous = self.viscous_nms_rad
        return Effects(
            friction=(JointFriction(self.index_in(joint_count), lambda speed, _load: viscous * speed),)
        )

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        unit = scale.joint_noise_nm / scale.joint(channel).speed_rad_s
        return cls(joint=joint_of(channel), viscous_nms_rad=strength * unit)
