"""A converter with coarse steps."""

from typing import ClassVar, Self

import numpy as np

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class Quantisation(SensorImperfection):
    """y = s round(u / s), after the noise (Widrow and Kollar, "Quantization Noise", 2008, ch. 1).

    Attributes:
        channel: see `SensorImperfection`.
        step: s [channel].
    """

    name: ClassVar[str] = "quantisation"

    step: NotNegative = parameter("channel", 0.02, 1.0)

    def transducer(self) -> Transducer:
        """See `SensorImperfection.transducer`."""
        step = self.step
        return lambda _time_s, value: round(value / step) * step if step else value

    @classmethod
    def can_show_in(cls, channel: str) -> bool:
        """See `Imperfection.can_show_in`; the last joint has next to no torque to be wrong about."""
        return channel == CONTACT or channel in LOADED

    @classmethod
    def at_strength(
        cls, strength: float, channel: str, scale: NoiseScale, generator: np.random.Generator
    ) -> Self:
        """See `Imperfection.at_strength`; a step is the square root of 12 times its rounding's rms."""
        return cls(channel=channel, step=3.46 * strength * scale.noise(channel))
