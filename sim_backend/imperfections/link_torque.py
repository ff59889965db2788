"""Torque on a link that the drive knows nothing of."""

from abc import ABC, abstractmethod
from math import sin, tau
from typing import Self

import numpy as np
from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number
from sim_backend.channel_effect import JointTorque
from sim_backend.hooks import Effects
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale, joint_of


class _LinkTorque(JointImperfection, ABC):
    """A torque that comes on top of one drive's."""

    def effects(self, joint_count: int) -> Effects:
        return Effects(joint=(JointTorque(self.index_in(joint_count), self.torque_nm),))

    @abstractmethod
    def torque_nm(self, position_rad: float, drive_nm: float) -> float:
        """The torque on the link [N m], along the joint's axis, see `JointTorque`."""


class JointSpring(_LinkTorque):
    """tau += -k (q - q0) on the link: a cable or hose that bends, a balancing spring (Hooke)."""

    name = "joint_spring"
    stiffness_nm_rad: NotNegative = parameter("N m/rad", 0.05, 20.0, le=500.0)  # k [N m/rad]
    rest_rad: Number = parameter("rad", -3.1416, 3.1416, ge=-100.0, le=100.0, default=0.0)  # q0 [rad]

    def torque_nm(self, position_rad: float, drive_nm: float) -> float:
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


class TorqueRipple(_LinkTorque):
    """tau += A sin(N q + phi) on the link: cogging of the motor's magnets, teeth of the gear.

    Jahns and Soong, IEEE Trans. Industrial Electronics 43 (1996), "Pulsating torque minimization techniques".
    """

    name = "torque_ripple"
    amplitude_nm: NotNegative = parameter("N m", 0.02, 1.0, le=100.0)  # A [N m]
    cycles: Number = parameter("-", 6.0, 300.0, gt=0, le=1e4)  # N, in one turn of the joint [-]
    phase_rad: Number = parameter("rad", -3.1416, 3.1416, ge=-tau, le=tau, default=0.0)  # phi [rad]

    def torque_nm(self, position_rad: float, drive_nm: float) -> float:
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


class TorqueGain(_LinkTorque):
    """tau_link = g tau_drive: the drive sets and measures current, and takes a wrong constant.

    The measured torque follows the command; what reaches the link does not.
    """

    name = "torque_gain"
    shows_in = LOADED  # a tool that hangs straight down does not load its joint
    # g, true over believed motor constant; one is right [-].
    gain: Number = parameter("-", 0.8, 1.2, ge=0.2, le=3.0)

    def torque_nm(self, position_rad: float, drive_nm: float) -> float:
        return (self.gain - 1.0) * drive_nm

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        excess = strength * scale.joint_noise_nm / scale.joint(channel).load_nm
        gain = float(np.clip(1.0 + generator.choice([-1.0, 1.0]) * excess, 0.5, 2.0))
        return cls(joint=joint_of(channel), gain=gain)
