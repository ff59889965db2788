"""A converter with coarse steps."""

from collections.abc import Sequence
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class Quantisation(SensorImperfection):
    """y = s round(u / s), after the noise (Widrow and Kollar, "Quantization Noise", 2008, ch. 1)."""

    name: ClassVar[str] = "quantisation"
    # The last joint has next to no torque to be wrong about.
    shows_in: ClassVar[Sequence[str]] = (CONTACT, *LOADED)
    step: NotNegative = parameter("channel", 0.02, 1.0)  # s [channel]

    def transducer(self) -> Transducer:
        step = self.step
        return lambda _time_s, value: round(value / step) * step if step else value

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; a step is the square root of 12 times its rounding's rms."""
        return cls(channel=channel, step=3.46 * strength * scale.noise(channel))
