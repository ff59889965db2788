"""A sensor whose zero is off."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class Bias(SensorImperfection):
    """y = u + b (ISO/IEC Guide 99 (VIM), 4.20: instrumental bias)."""

    name: ClassVar[str] = "bias"
    bias: Number = parameter("channel", -2.0, 2.0)  # b [channel]

    def transducer(self) -> Transducer:
        bias = self.bias
        return lambda _time_s, value: value + bias

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; a probing run takes the force in free air as zero."""
        return cls(channel=channel, bias=generator.choice([-1.0, 1.0]) * strength * scale.noise(channel))
