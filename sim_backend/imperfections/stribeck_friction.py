"""Friction that falls as the joint begins to slide."""

from math import exp
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Positive
from sim_backend.channel_effect import JointFriction
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import NoiseScale, joint_of


class StribeckFriction(JointImperfection):
    """tau = f + s exp(-(|dq/dt| / v_s)^2) against the motion: the film of grease carries from v_s on.

    Bo and Pavelescu, Wear 82 (1982), with the exponent 2; Armstrong-Helouvry et al., Automatica 30 (1994).
    """

    name: ClassVar[str] = "stribeck_friction"
    # s, how much more at rest than sliding [N m].
    stiction_nm: NotNegative = parameter("N m", 0.02, 2.0, le=100.0)
    speed_rad_s: Positive = parameter("rad/s", 0.01, 0.5, ge=1e-4, le=10.0)  # v_s [rad/s]
    # f, what is left at speed [N m].
    coulomb_nm: NotNegative = parameter("N m", 0.0, 2.0, le=100.0, default=0.0)

    def effects(self, joint_count: int) -> Effects:
        return Effects(friction=(JointFriction(self.index_in(joint_count), self._resistance_nm),))

    def _resistance_nm(self, speed_rad_s: float, _load_nm: float) -> float:
        slowness = speed_rad_s / self.speed_rad_s
        return self.coulomb_nm + self.stiction_nm * exp(-slowness * slowness)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at most what a controller masters that does not know it."""
        joint = scale.joint(channel)
        return cls(
            joint=joint_of(channel),
            stiction_nm=min(strength * scale.joint_noise_nm / 0.4, joint.mastered_nm),
            speed_rad_s=generator.uniform(0.2, 0.6) * joint.speed_rad_s,
        )
