"""A base that does not stand level."""

from collections.abc import Sequence
from math import cos, sin
from typing import Self

from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.hooks import Effects, PlantEffect
from sim_backend.imperfection import Imperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale, channel_of


class GravityTilt(Imperfection):
    """Gravity is turned against the arm's base, g = R^T (0, 0, -9.81): the table is not level.

    R turns the base by `pitch_rad` about its y axis, x dipping, after `roll_rad` about its x axis. The object
    is tilted with it. An arm that moves in the x-z plane feels pitch alone.
    """

    name = "gravity_tilt"
    shows_in = LOADED
    pitch_rad: Number = parameter("rad", -0.1, 0.1, ge=-1.6, le=1.6)  # about y [rad]
    roll_rad: Number = parameter("rad", -0.1, 0.1, ge=-1.6, le=1.6, default=0.0)  # about x [rad]

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; the base's joint carries most of the arm, and those after it less."""
        return tuple(channel_of(joint) for joint in (1, 2, 3))

    def effects(self, joint_count: int) -> Effects:
        return Effects(plant=(_Slope(self.pitch_rad, self.roll_rad),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        sign = generator.choice([-1.0, 1.0])
        return cls(pitch_rad=sign * strength * scale.joint_noise_nm / scale.joint(channel).tilt_nm_rad)


class _Slope(PlantEffect):
    def __init__(self, pitch_rad: float, roll_rad: float) -> None:
        self._pitch_rad = pitch_rad
        self._roll_rad = roll_rad

    def gravity_m_s2(self, gravity_m_s2: Sequence[float]) -> Sequence[float]:
        """The vector in the tilted base's frame: turned back about y, then about x."""
        x, y, z = gravity_m_s2
        c, s = cos(self._pitch_rad), sin(self._pitch_rad)
        x, z = c * x - s * z, s * x + c * z
        c, s = cos(self._roll_rad), sin(self._roll_rad)
        return x, c * y + s * z, -s * y + c * z
