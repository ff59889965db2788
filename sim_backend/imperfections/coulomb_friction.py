"""Dry friction of a constant amount."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import JointFriction
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import NoiseScale, joint_of


class CoulombFriction(JointImperfection):
    """tau = f against the motion; a joint at rest stays there until more than f pulls at it.

    Coulomb 1785; Armstrong-Helouvry et al., Automatica 30 (1994), sec. 2.
    """

    name: ClassVar[str] = "coulomb_friction"
    coulomb_nm: NotNegative = parameter("N m", 0.02, 2.0, le=100.0)  # f [N m]

    def effects(self, joint_count: int) -> Effects:
        coulomb_nm = self.coulomb_nm
        return Effects(
            friction=(JointFriction(self.index_in(joint_count), lambda _speed, _load: coulomb_nm),)
        )

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at most what a controller masters that does not know it."""
        coulomb_nm = min(strength * scale.joint_noise_nm, scale.joint(channel).mastered_nm)
        return cls(joint=joint_of(channel), coulomb_nm=coulomb_nm)
