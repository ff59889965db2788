"""Torque that comes and goes as the joint turns."""

from math import sin, tau
from typing import ClassVar, Self

import numpy as np
from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number
from sim_backend.channel_effect import JointTorque
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import NoiseScale, joint_of


class TorqueRipple(JointImperfection):
    """tau += A sin(N q + phi) on the link: cogging of the motor's magnets, teeth of the gear.

    Jahns and Soong, IEEE Trans. Industrial Electronics 43 (1996), "Pulsating torque minimization techniques".
    """

    name: ClassVar[str] = "torque_ripple"
    amplitude_nm: NotNegative = parameter("N m", 0.02, 1.0, le=100.0)  # A [N m]
    cycles: Number = parameter("-", 6.0, 300.0, gt=0, le=1e4)  # N, in one turn of the joint [-]
    phase_rad: Number = parameter("rad", -3.1416, 3.1416, ge=-tau, le=tau, default=0.0)  # phi [rad]

    def effects(self, joint_count: int) -> Effects:
        return Effects(joint=(JointTorque(self.index_in(joint_count), self._torque_nm),))

    def _torque_nm(self, position_rad: float, _drive_nm: float) -> float:
        return self.amplitude_nm * sin(self.cycles * position_rad + self.phase_rad)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; some cycles within the swing, and not too much to control."""
        joint = scale.joint(channel)
        cycles = np.exp(generator.uniform(np.log(6.0), np.log(18.0))) / joint.swing_rad
        return cls(
            joint=joint_of(channel),
            amplitude_nm=min(1.4 * strength * scale.joint_noise_nm, joint.mastered_nm),
            cycles=float(np.round(cycles)),
            phase_rad=generator.uniform(-np.pi, np.pi),
        )
