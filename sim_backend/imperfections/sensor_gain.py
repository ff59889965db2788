"""A sensor whose scale is not what its data sheet says."""

from typing import ClassVar, Self

import numpy as np

from robot_io.files.file_model import Number, Positive
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, NoiseScale


class SensorGain(SensorImperfection):
    """y = g u (1 + c u): wrong sensitivity and a bent characteristic (VIM 4.12, 4.27).

    Seen only by those who know what was measured; a probing run takes it for a stiffer or softer object.

    Attributes:
        channel: see `SensorImperfection`.
        gain: g, shown over true [-].
        bend: c, the sensitivity's change with the signal [1/channel].
    """

    name: ClassVar[str] = "sensor_gain"
    ahead_of_noise: ClassVar[bool] = True

    gain: Positive = parameter("-", 0.8, 1.2, le=10.0)
    bend: Number = parameter("1/channel", -1e-3, 1e-3, ge=-0.1, le=0.1, default=0.0)

    def transducer(self) -> Transducer:
        """See `SensorImperfection.transducer`."""
        gain, bend = self.gain, self.bend
        return lambda _time_s, value: gain * value * (1.0 + bend * value)

    @classmethod
    def can_show_in(cls, channel: str) -> bool:
        """See `Imperfection.can_show_in`; stiffness and damping take it over."""
        return False

    @classmethod
    def at_strength(
        cls, strength: float, channel: str, scale: NoiseScale, generator: np.random.Generator
    ) -> Self:
        """See `Imperfection.at_strength`; here of the whole change, for an object that is known."""
        load = scale.force_n if channel == CONTACT else 1.0
        return cls(channel=channel, gain=1.0 + strength * scale.noise(channel) / load)
