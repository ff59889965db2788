"""A sensor that does not feel what is small."""

from collections.abc import Sequence
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class Deadband(SensorImperfection):
    """y = 0 within +- w, and u - w or u + w beyond: lost motion ahead of the sensing element (VIM 4.17)."""

    name: ClassVar[str] = "deadband"
    # The last joint has next to no torque to be wrong about.
    shows_in: ClassVar[Sequence[str]] = (CONTACT, *LOADED)
    ahead_of_noise: ClassVar[bool] = True
    half_width: NotNegative = parameter("channel", 0.02, 1.0)  # w [channel]

    def transducer(self) -> Transducer:
        width = self.half_width
        return lambda _time_s, value: value - max(-width, min(width, value))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(channel=channel, half_width=strength * scale.noise(channel))
