"""A sensor that is late without saying so."""

from collections import deque
from collections.abc import Sequence
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class Delay(SensorImperfection):
    """y(t) = u(t - d), under the time stamp t: a converter or bus that hides its own delay.

    Between two samples the signal is taken as straight.
    """

    name: ClassVar[str] = "delay"
    # The last joint has next to no torque to be wrong about.
    shows_in: ClassVar[Sequence[str]] = (CONTACT, *LOADED)
    ahead_of_noise: ClassVar[bool] = True
    delay_s: NotNegative = parameter("s", 0.0005, 0.02, le=1.0)  # d [s]

    def transducer(self) -> Transducer:
        return _DelayLine(self.delay_s).read

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(channel=channel, delay_s=min(strength * scale.noise(channel) / scale.rate(channel), 0.1))


class _DelayLine:
    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._samples: deque[tuple[float, float]] = deque()

    def read(self, time_s: float, value: float) -> float:
        samples, wanted_s = self._samples, time_s - self._delay_s
        samples.append((time_s, value))
        while len(samples) > 1 and samples[1][0] <= wanted_s:
            samples.popleft()
        (first_s, first), (second_s, second) = samples[0], samples[min(1, len(samples) - 1)]
        if wanted_s <= first_s or second_s <= first_s:
            return first
        return first + (second - first) * (wanted_s - first_s) / (second_s - first_s)
