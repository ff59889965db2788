"""A sensor whose scale is not what its data sheet says."""

from collections.abc import Sequence
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import Number, Positive
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, NoiseScale


class SensorGain(SensorImperfection):
    """y = g u (1 + c u): wrong sensitivity and a bent characteristic (VIM 4.12, 4.27).

    Seen only by those who know what was measured; a probing run takes it for a stiffer or softer object.
    """

    name: ClassVar[str] = "sensor_gain"
    shows_in: ClassVar[Sequence[str]] = ()  # stiffness and damping take it over
    ahead_of_noise: ClassVar[bool] = True
    gain: Positive = parameter("-", 0.8, 1.2, le=10.0)  # g, shown over true [-]
    # c, the sensitivity's change with the signal [1/channel].
    bend: Number = parameter("1/channel", -1e-3, 1e-3, ge=-0.1, le=0.1, default=0.0)

    def transducer(self) -> Transducer:
        gain, bend = self.gain, self.bend
        return lambda _time_s, value: gain * value * (1.0 + bend * value)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; here of the whole change, for an object that is known."""
        load = scale.force_n if channel == CONTACT else 1.0
        return cls(channel=channel, gain=1.0 + strength * scale.noise(channel) / load)
