"""A sensor that makes something else of each sample by itself."""

from typing import Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number, Positive
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class Bias(SensorImperfection):
    """y = u + b (ISO/IEC Guide 99 (VIM), 4.20: instrumental bias)."""

    name = "bias"
    bias: Number = parameter("channel", -2.0, 2.0)  # b [channel]

    def transducer(self) -> Transducer:
        bias = self.bias
        return lambda _time_s, value: value + bias

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; a probing run takes the force in free air as zero."""
        return cls(channel=channel, bias=generator.choice([-1.0, 1.0]) * strength * scale.noise(channel))


class SensorGain(SensorImperfection):
    """y = g u (1 + c u): wrong sensitivity and a bent characteristic (VIM 4.12, 4.27).

    Seen only by those who know what was measured; a probing run takes it for a stiffer or softer object.
    """

    name = "sensor_gain"
    shows_in = ()  # stiffness and damping take it over
    ahead_of_noise = True
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


class Saturation(SensorImperfection):
    """y = u within +- L and +- L beyond: an amplifier at its supply, with no mark on the samples.

    An arm that loads by a force sensor of this kind goes on pressing to its depth limit once L is below the
    force that is asked for.
    """

    name = "saturation"
    shows_in = LOADED  # the arm loads the object by the force sensor itself
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


class Deadband(SensorImperfection):
    """y = 0 within +- w, and u - w or u + w beyond: lost motion ahead of the sensing element (VIM 4.17)."""

    name = "deadband"
    # The last joint has next to no torque to be wrong about.
    shows_in = (CONTACT, *LOADED)
    ahead_of_noise = True
    half_width: NotNegative = parameter("channel", 0.02, 1.0)  # w [channel]

    def transducer(self) -> Transducer:
        width = self.half_width
        return lambda _time_s, value: value - max(-width, min(width, value))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(channel=channel, half_width=strength * scale.noise(channel))


class Quantisation(SensorImperfection):
    """y = s round(u / s), after the noise (Widrow and Kollar, "Quantization Noise", 2008, ch. 1)."""

    name = "quantisation"
    # The last joint has next to no torque to be wrong about.
    shows_in = (CONTACT, *LOADED)
    step: NotNegative = parameter("channel", 0.02, 1.0)  # s [channel]

    def transducer(self) -> Transducer:
        step = self.step
        return lambda _time_s, value: round(value / step) * step if step else value

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; a step is the square root of 12 times its rounding's rms."""
        return cls(channel=channel, step=3.46 * strength * scale.noise(channel))
