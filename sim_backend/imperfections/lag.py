"""A sensor that follows slowly."""

from collections.abc import Sequence
from math import exp
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class Lag(SensorImperfection):
    """T dy/dt = u - y: a filter in the amplifier, a soft cell (first-order low-pass).

    Exact for a signal that changes at a constant rate between two samples.
    """

    name: ClassVar[str] = "lag"
    # The last joint has next to no torque to be wrong about.
    shows_in: ClassVar[Sequence[str]] = (CONTACT, *LOADED)
    ahead_of_noise: ClassVar[bool] = True
    time_s: NotNegative = parameter("s", 0.001, 0.05, le=10.0)  # T [s]

    def transducer(self) -> Transducer:
        return _Following(self.time_s).read

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(channel=channel, time_s=min(strength * scale.noise(channel) / scale.rate(channel), 0.1))


class _Following:
    def __init__(self, time_s: float) -> None:
        self._time_s = time_s
        self._last: tuple[float, float, float] | None = None

    def read(self, time_s: float, value: float) -> float:
        if self._last is None or not self._time_s:
            output = value
        else:
            last_s, last_value, last_output = self._last
            steps = (time_s - last_s) / self._time_s
            left, behind = exp(-steps), (value - last_value) / steps
            output = value - behind + left * (last_output - last_value + behind)
        self._last = time_s, value, output
        return output
