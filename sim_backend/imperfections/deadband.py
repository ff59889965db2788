"""A sensor that does not feel what is small."""

from typing import ClassVar, Self

import numpy as np

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class Deadband(SensorImperfection):
    """y = 0 within +- w, and u - w or u + w beyond: lost motion ahead of the sensing element (VIM 4.17).

    Attributes:
        channel: see `SensorImperfection`.
        half_width: w [channel].
    """

    name: ClassVar[str] = "deadband"
    ahead_of_noise: ClassVar[bool] = True

    half_width: NotNegative = parameter("channel", 0.02, 1.0)

    def transducer(self) -> Transducer:
        """See `SensorImperfection.transducer`."""
        width = self.half_width
        return lambda _time_s, value: value - max(-width, min(width, value))

    @classmethod
    def can_show_in(cls, channel: str) -> bool:
        """See `Imperfection.can_show_in`; the last joint has next to no torque to be wrong about."""
        return channel == CONTACT or channel in LOADED

    @classmethod
    def at_strength(
        cls, strength: float, channel: str, scale: NoiseScale, generator: np.random.Generator
    ) -> Self:
        """See `Imperfection.at_strength`."""
        return cls(channel=channel, half_width=strength * scale.noise(channel))
