"""A sensor that reads less on the way up than on the way down."""

from collections.abc import Sequence
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class Hysteresis(SensorImperfection):
    """y follows u with a play of +- w: up to w less while u rises, up to w more while it falls.

    The play operator, of which Prandtl and Ishlinskii build all hysteresis; Brokate and Sprekels, "Hysteresis
    and Phase Transitions", 1996.
    """

    name: ClassVar[str] = "hysteresis"
    # The last joint has next to no torque to be wrong about.
    shows_in: ClassVar[Sequence[str]] = (CONTACT, *LOADED)
    ahead_of_noise: ClassVar[bool] = True
    half_width: NotNegative = parameter("channel", 0.02, 1.0)  # w [channel]

    def transducer(self) -> Transducer:
        return _Play(self.half_width).read

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(channel=channel, half_width=strength * scale.noise(channel))


class _Play:
    def __init__(self, half_width: float) -> None:
        self._half_width = half_width
        self._output: float | None = None

    def read(self, _time_s: float, value: float) -> float:
        output = value if self._output is None else self._output
        self._output = max(value - self._half_width, min(value + self._half_width, output))
        return self._output
