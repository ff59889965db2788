"""A sensor that stops short of its range without saying so."""

from collections.abc import Sequence
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import Positive
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale


class Saturation(SensorImperfection):
    """y = u within +- L and +- L beyond: an amplifier at its supply, with no mark on the samples.

    An arm that loads by a force sensor of this kind goes on pressing to its depth limit once L is below the
    force that is asked for.
    """

    name: ClassVar[str] = "saturation"
    shows_in: ClassVar[Sequence[str]] = LOADED  # the arm loads the object by the force sensor itself
    limit: Positive = parameter("channel", 0.5, 50.0)  # L [channel]

    def transducer(self) -> Transducer:
        limit = self.limit
        return lambda _time_s, value: max(-limit, min(limit, value))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        if not strength:
            return cls(channel=channel, limit=1e9)
        peak = scale.peak(channel)
        return cls(channel=channel, limit=max(peak - 5.0 * strength * scale.noise(channel), 0.2 * peak))
