"""A sensor whose reading depends on the samples before."""

from collections import deque
from math import exp
from typing import Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number
from sim_backend.channel_effect import Transducer
from sim_backend.imperfection import SensorImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale


class Drift(SensorImperfection):
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


class Hysteresis(_Mechanical):
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


class Lag(_Mechanical):
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


class Delay(_Mechanical):
    """y(t) = u(t - d), under the time stamp t: a converter or bus that hides its own delay.

    Between two samples the signal is taken as straight.
    """

    name = "delay"
    delay_s: NotNegative = parameter("s", 0.0005, 0.02, le=1.0)  # d [s]

    def transducer(self) -> Transducer:
        samples: deque[tuple[float, float]] = deque()

        def late(time_s: float, value: float) -> float:
            wanted_s = time_s - self.delay_s
            samples.append((time_s, value))
            while len(samples) > 1 and samples[1][0] <= wanted_s:
                samples.popleft()
            (first_s, first), (second_s, second) = samples[0], samples[min(1, len(samples) - 1)]
            if wanted_s <= first_s or second_s <= first_s:
                return first
            return first + (second - first) * (wanted_s - first_s) / (second_s - first_s)

        return late

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(channel=channel, delay_s=min(strength * scale.noise(channel) / scale.rate(channel), 0.1))
