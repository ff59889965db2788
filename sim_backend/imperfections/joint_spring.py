"""A spring between two links."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number
from sim_backend.channel_effect import JointTorque
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import NoiseScale, joint_of


class JointSpring(JointImperfection):
    """tau += -k (q - q0) on the link: a cable or hose that bends, a balancing spring (Hooke)."""

    name: ClassVar[str] = "joint_spring"
    stiffness_nm_rad: NotNegative = parameter("N m/rad", 0.05, 20.0, le=500.0)  # k [N m/rad]
    rest_rad: Number = parameter("rad", -3.1416, 3.1416, ge=-100.0, le=100.0, default=0.0)  # q0 [rad]

    def effects(self, joint_count: int) -> Effects:
        return Effects(joint=(JointTorque(self.index_in(joint_count), self._torque_nm),))

    def _torque_nm(self, position_rad: float, _drive_nm: float) -> float:
        return -self.stiffness_nm_rad * (position_rad - self.rest_rad)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at rest near the middle, and weaker than the controller."""
        joint = scale.joint(channel)
        stiffness_nm_rad = strength * scale.joint_noise_nm / (0.8 * joint.swing_rad)
        return cls(
            joint=joint_of(channel),
            stiffness_nm_rad=min(stiffness_nm_rad, 1000.0 * joint.inertia_kg_m2),
            rest_rad=joint.middle_rad + joint.swing_rad * generator.uniform(-1.0, 1.0),
        )
