"""A sensor whose zero wanders."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class Drift(SensorImperfection):
    """y = u + r (t - t0), t0 the time of the first sample: a sensor that warms up (VIM 4.21)."""

    name: ClassVar[str] = "drift"
    rate_1_s: Number = parameter("channel/s", -0.5, 0.5)  # r [channel/s]

    def transducer(self) -> Transducer:
        return _Wandering(self.rate_1_s).read

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        sign = generator.choice([-1.0, 1.0])
        return cls(channel=channel, rate_1_s=sign * strength * scale.noise(channel) / (0.4 * scale.session_s))


class _Wandering:
    def __init__(self, rate_1_s: float) -> None:
        self._rate_1_s = rate_1_s
        self._start_s: float | None = None

    def read(self, time_s: float, value: float) -> float:
        if self._start_s is None:
            self._start_s = time_s
        return value + self._rate_1_s * (time_s - self._start_s)
