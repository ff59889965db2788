"""Friction that grows with the square of the speed."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import JointFriction
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import NoiseScale, joint_of


class QuadraticFriction(JointImperfection):
    """tau = b2 (dq/dt)^2 against the motion: churned oil, air.

    Drag at large Reynolds numbers; Batchelor, "An Introduction to Fluid Dynamics", 1967, sec. 5.11.
    """

    name: ClassVar[str] = "quadratic_friction"
    quadratic_nms2_rad2: NotNegative = parameter("N m s^2/rad^2", 0.05, 20.0, le=1000.0)  # b2 [N m s^2/rad^2]

    def effects(self, joint_count: int) -> Effects:
        quadratic = self.quadratic_nms2_rad2
        index = self.index_in(joint_count)
        return Effects(friction=(JointFriction(index, lambda speed, _load: quadratic * speed * speed),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        unit = scale.joint_noise_nm / (1.2 * scale.joint(channel).speed_rad_s ** 2)
        return cls(joint=joint_of(channel), quadratic_nms2_rad2=strength * unit)
