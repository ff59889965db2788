"""When a sensor samples, and when the sample can be read."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from math import exp, floor, inf, pi
from typing import NamedTuple

import numpy as np

from robot_io.types import Status

_SAME_TIME_S = 1e-9  # physics times are multiples of the step; closer than this is the same instant


class LowPass:
    """dy/dt = 2 pi f (u - y), for several signals at once; the bandwidth is the corner frequency f [Hz]."""

    def __init__(self, bandwidth_hz: float, step_s: float) -> None:
        self._gain = 1.0 - exp(-2.0 * pi * bandwidth_hz * step_s)
        self._output: list[float] | None = None

    def filter(self, signal: Sequence[float]) -> list[float]:
        """The output after one more step; the first call starts settled at `signal`."""
        if self._output is None:
            self._output = list(signal)
        else:
            gain = self._gain
            self._output = [y + gain * (u - y) for u, y in zip(signal, self._output, strict=True)]
        return self._output


class Sample(NamedTuple):
    """One sample of a device."""

    value: list[float]  # in the unit of the sensor
    sampled_at_s: float  # when the device sampled [s]
    status: Status = Status.OK  # how far to trust it


class SampledSensor(ABC):
    """A sensor that samples at its own rate and hands a sample out after its delay.

    The world shows it the true signal at every physics step; it samples at the first step at or after each
    of its sampling instants, so `sampled_at_s` is always the time of a state that existed. Above the physics
    rate, every step is a sample.

    The first sampling period begins at `start_s` [s]; what is seen then is sampled whatever the phase, which
    is where in the period the sampling instants are, from 0 to 1. A low-pass is an analogue filter ahead of
    the sampling. Before the time `look_s` `observe` does nothing and need not be called [s].
    """

    def __init__(
        self,
        rate_hz: float,
        delay_s: float,
        start_s: float,
        phase: float = 0.0,
        low_pass: LowPass | None = None,
    ) -> None:
        self._period_s = 1.0 / rate_hz
        self._delay_s = delay_s
        self._first_instant_s = start_s + phase / rate_hz
        self._sample_s = start_s - _SAME_TIME_S
        self._low_pass = low_pass
        self.look_s = -inf if low_pass else self._sample_s
        # As many as can be on their way at once, and the newest that has arrived.
        self._samples: deque[Sample] = deque(maxlen=floor(delay_s * rate_hz) + 3)
        self._shown_at_s: float | None = None

    @abstractmethod
    def _measure(self, time_s: float, signal: Sequence[float]) -> Sample:
        """Make a sample of the true signal."""

    def observe(self, time_s: float, signal: Sequence[float]) -> None:
        """See the true signal at a physics step, and sample it if it is time to."""
        if self._low_pass:
            signal = self._low_pass.filter(signal)
        if time_s < self._sample_s:
            return
        periods = floor((time_s - self._first_instant_s + _SAME_TIME_S) / self._period_s) + 1
        self._sample_s = self._first_instant_s + periods * self._period_s - _SAME_TIME_S  # the next instant
        if not self._low_pass:
            self.look_s = self._sample_s
        self._samples.append(self._measure(time_s, signal))

    def read(self, time_s: float) -> Sample | None:
        """The newest sample that has arrived by `time_s`, None before the first; stale if shown before."""
        arrived_s = time_s - self._delay_s + _SAME_TIME_S
        for sample in reversed(self._samples):
            if sample.sampled_at_s <= arrived_s:
                break
        else:
            return None
        if sample.sampled_at_s == self._shown_at_s:
            return sample._replace(status=Status.STALE)
        self._shown_at_s = sample.sampled_at_s
        return sample


_BLOCK = 1024


class GaussianNoise:
    """An endless row of independent N(0, std^2) numbers, in the unit of the signal."""

    def __init__(self, std: float, generator: np.random.Generator) -> None:
        self._std = std
        self._generator = generator
        self._block: list[float] = []

    def added_to(self, signal: Sequence[float]) -> Sequence[float]:
        """The signal with the next of these numbers on each of its values."""
        if not self._std:
            return signal
        if len(self._block) < len(signal):
            self._block = self._generator.normal(0.0, self._std, _BLOCK).tolist() + self._block
        draw = self._block.pop
        return [value + draw() for value in signal]


def quantise(values: Sequence[float], step: float) -> list[float]:
    """The multiples of `step` nearest to `values`, all in the same unit; a step of 0 changes nothing."""
    return [round(value / step) * step for value in values] if step else list(values)
