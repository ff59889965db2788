"""Dry friction that is larger in one direction than in the other."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import JointFriction, JointTorque
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import NoiseScale, joint_of


class AsymmetricFriction(JointImperfection):
    """tau = f+ against positive and f- against negative motion: a seal, a cable, a worm gear.

    The same as Coulomb friction of (f+ + f-)/2 beside a constant torque of -(f+ - f-)/2, at rest too.
    Armstrong-Helouvry, "Control of Machines with Friction", 1991, sec. 2.
    """

    name: ClassVar[str] = "asymmetric_friction"
    positive_nm: NotNegative = parameter("N m", 0.0, 2.0, le=100.0)  # f+ [N m]
    negative_nm: NotNegative = parameter("N m", 0.0, 2.0, le=100.0)  # f- [N m]

    def effects(self, joint_count: int) -> Effects:
        index = self.index_in(joint_count)
        mean_nm = 0.5 * (self.positive_nm + self.negative_nm)
        constant_nm = -0.5 * (self.positive_nm - self.negative_nm)
        return Effects(
            joint=(JointTorque(index, lambda _position, _drive: constant_nm),),
            friction=(JointFriction(index, lambda _speed, _load: mean_nm),),
        )

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at most what a controller masters that does not know it."""
        large_nm = min(1.3 * strength * scale.joint_noise_nm, scale.joint(channel).mastered_nm)
        small_nm = generator.uniform(0.1, 0.5) * large_nm
        positive_nm, negative_nm = generator.permutation([large_nm, small_nm]).tolist()
        return cls(joint=joint_of(channel), positive_nm=positive_nm, negative_nm=negative_nm)
