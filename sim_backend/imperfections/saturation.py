"""A sensor that stops short of its range without saying so."""

from typing import ClassVar, Self

import numpy as np

from robot_io.files.file_model import Positive
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale


class Saturation(SensorImperfection):
    """y = u within +- L and +- L beyond: an amplifier at its supply, with no mark on the samples.

    An arm that loads by a force sensor of this kind goes on pressing to its depth limit once L is below the
    force that is asked for.

    Attributes:
        channel: see `SensorImperfection`.
        limit: L [channel].
    """

    name: ClassVar[str] = "saturation"

    limit: Positive = parameter("channel", 0.5, 50.0)

    def transducer(self) -> Transducer:
        """See `SensorImperfection.transducer`."""
        limit = self.limit
        return lambda _time_s, value: max(-limit, min(limit, value))

    @classmethod
    def can_show_in(cls, channel: str) -> bool:
        """See `Imperfection.can_show_in`; the arm loads the object by the force sensor itself."""
        return channel in LOADED

    @classmethod
    def at_strength(
        cls, strength: float, channel: str, scale: NoiseScale, generator: np.random.Generator
    ) -> Self:
        """See `Imperfection.at_strength`."""
        if not strength:
            return cls(channel=channel, limit=1e9)
        peak = scale.peak(channel)
        return cls(channel=channel, limit=max(peak - 5.0 * strength * scale.noise(channel), 0.2 * peak))
