"""Play between drive and link."""

from collections.abc import Sequence
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Positive
from sim_backend.hooks import Effects, JointEffect, JointState, SensorEffect
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import CONTACT, NoiseScale, channel_of, joint_of


class Backlash(JointImperfection):
    """The encoder, on the drive's side, is ahead of the link by u within +- gap/2, on the side that pushes.

    A drive without inertia of its own lets the whole torque through. It crosses the gap when the torque
    changes sign, du/dt = tau / d, held up by the grease: the physical model of Nordin and Gutman, Automatica
    38 (2002), with a shaft that only damps. The rotor's inertia is counted to the link, as the URDF does.
    """

    name: ClassVar[str] = "backlash"
    shows_in: ClassVar[Sequence[str]] = ()  # in probing, weight keeps the play on one side
    gap_rad: NotNegative = parameter("rad", 2e-4, 0.01, le=0.2)  # from one flank to the other [rad]
    # d, of the grease in the gap [N m s/rad].
    film_nms_rad: Positive = parameter("N m s/rad", 1.0, 100.0, ge=0.1, le=1e4, default=10.0)

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; the tip is not where the encoders say."""
        return (channel_of(self.joint), CONTACT)

    def effects(self, joint_count: int) -> Effects:
        play = _Play(self.index_in(joint_count), self.gap_rad, self.film_nms_rad)
        return Effects(joint=(play,), encoder=(play,))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; here of what a controller does about the gap that it sees."""
        stiffness_nm_rad = 3600.0 * scale.joint(channel).inertia_kg_m2
        gap_rad = strength * scale.joint_noise_nm / stiffness_nm_rad
        return cls(joint=joint_of(channel), gap_rad=min(gap_rad, 0.02))


class _Play(JointEffect, SensorEffect):
    def __init__(self, index: int, gap_rad: float, film_nms_rad: float) -> None:
        self._index = index
        self._reach_rad = 0.5 * gap_rad
        self._film_nms_rad = film_nms_rad
        self.restart()

    def restart(self) -> None:
        self._ahead_rad = 0.0

    def joint_torque_nm(self, state: JointState, torque_nm: Sequence[float]) -> Sequence[float]:
        ahead_rad = self._ahead_rad + state.step_s * torque_nm[self._index] / self._film_nms_rad
        self._ahead_rad = max(-self._reach_rad, min(self._reach_rad, ahead_rad))
        return torque_nm

    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        changed = list(value)
        changed[self._index] += self._ahead_rad
        return changed
