"""Hidden effects in a sensor: static characteristics, and dynamics."""

from collections import deque
from math import exp
from typing import Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number, Positive
from sim_backend.hooks import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class HiddenBias(SensorImperfection):
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


class HiddenSensorGain(SensorImperfection):
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


class HiddenSaturation(SensorImperfection):
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


class HiddenDeadband(SensorImperfection):
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


class HiddenQuantisation(SensorImperfection):
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


class HiddenDrift(SensorImperfection):
    """y = u + r (t - t0), t0 the time of the first sample: a sensor that warms up (VIM 4.21)."""

    name = "drift"
    rate_1_s: Number = parameter("channel/s", -0.5, 0.5)  # r [channel/s]

    def transducer(self) -> Transducer:
        start_s: float | None = None

        def wandering(time_s: float, value: float) -> float:
            nonlocal start_s
            start_s = time_s if start_s is None else start_s
            return value + self.rate_1_s * (time_s - start_s)

        return wandering

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        sign = generator.choice([-1.0, 1.0])
        return cls(channel=channel, rate_1_s=sign * strength * scale.noise(channel) / (0.4 * scale.session_s))


class _Mechanical(SensorImperfection):
    """A sensor that follows; the last joint has next to no torque to be wrong about."""

    shows_in = (CONTACT, *LOADED)
    ahead_of_noise = True


class HiddenHysteresis(_Mechanical):
    """y follows u with a play of +- w: up to w less while u rises, up to w more while it falls.

    The play operator, of which Prandtl and Ishlinskii build all hysteresis; Brokate and Sprekels, "Hysteresis
    and Phase Transitions", 1996.
    """

    name = "hysteresis"
    half_width: NotNegative = parameter("channel", 0.02, 1.0)  # w [channel]

    def transducer(self) -> Transducer:
        output: float | None = None

        def play(_time_s: float, value: float) -> float:
            nonlocal output
            before = value if output is None else output
            output = max(value - self.half_width, min(value + self.half_width, before))
            return output

        return play

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(channel=channel, half_width=strength * scale.noise(channel))


class HiddenLag(_Mechanical):
    """T dy/dt = u - y: a filter in the amplifier, a soft cell (first-order low-pass).

    Exact for a signal that changes at a constant rate between two samples.
    """

    name = "lag"
    time_s: NotNegative = parameter("s", 0.001, 0.05, le=10.0)  # T [s]

    def transducer(self) -> Transducer:
        last: tuple[float, float, float] | None = None  # time, value and output

        def following(time_s: float, value: float) -> float:
            nonlocal last
            output = value
            if last is not None and self.time_s:
                last_s, last_value, last_output = last
                steps = (time_s - last_s) / self.time_s
                left, behind = exp(-steps), (value - last_value) / steps
                output = value - behind + left * (last_output - last_value + behind)
            last = time_s, value, output
            return output

        return following

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(channel=channel, time_s=min(strength * scale.noise(channel) / scale.rate(channel), 0.1))


class HiddenDelay(_Mechanical):
    """y(t) = u(t - d), under the time stamp t: a converter or bus that hides its own delay.

    Between two samples the signal is taken as straight.
    """

    name = "delay"
    delay_s: NotNegative = parameter("s", 0.0005, 0.02, le=1.0)  # d [s]

    def transducer(self) -> Transducer:
        samples: deque[tuple[float, float]] = deque()

        def late(time_s: float, value: float) -> float:
            delayed_s = time_s - self.delay_s
            samples.append((time_s, value))
            while len(samples) > 1 and samples[1][0] <= delayed_s:
                samples.popleft()
            (first_s, first), (second_s, second) = samples[0], samples[min(1, len(samples) - 1)]
            if delayed_s <= first_s or second_s <= first_s:
                return first
            return first + (second - first) * (delayed_s - first_s) / (second_s - first_s)

        return late

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(channel=channel, delay_s=min(strength * scale.noise(channel) / scale.rate(channel), 0.1))
