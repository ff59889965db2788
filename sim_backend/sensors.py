"""Simulated sensors with sampling, quantization, saturation, noise and delay."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from math import exp, floor, inf, pi
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from palpate.robot_io.files.file_model import FileModel, NotNegative, Number, Positive
from palpate.robot_io.types import Status, clip
from palpate.sim_backend.hooks import SensorHook

Rate = Field(default=1000.0, gt=0, le=1e6)
Delay = Annotated[NotNegative, Field(le=10.0)]  # [s]


class ForceSettings(FileModel):
    """A uniaxial load cell with its amplifier and converter."""

    noise_std_n: NotNegative = 0.02  # white noise of a sample [N]
    resolution_n: NotNegative = 0.005  # one step of the converter [N]; 0 is none
    range_n: Positive = 100.0  # end of the range, push or pull [N]; a sample there is marked as saturated
    bandwidth_hz: Positive | None = None  # first-order low-pass ahead of the converter [Hz]; None is none
    rate_hz: Positive = Rate  # samples per second [Hz]
    delay_s: Delay = 0.0  # from the sampling instant until a sample can be read [s]


class TorqueSettings(FileModel):
    """The drives' own measurement of torque, from their current."""

    noise_std_nm: NotNegative = 0.01  # white noise of a sample [N m]
    resolution_nm: NotNegative = 0.002  # one step of the measurement [N m]; 0 is none
    # Resolution of a commanded torque [N m]; 0 for none.
    command_resolution_nm: NotNegative = 0.001
    rate_hz: Positive = Rate  # samples per second [Hz]
    delay_s: Delay = 0.0  # from the sampling instant until a sample can be read [s]
    # Where in the sampling period a sample is taken, from 0 to 1. Half way is the middle of the time for
    # which a command of the same rate holds: torque and motion of that time go together.
    phase: Number = Field(default=0.5, ge=0, lt=1)


class VelocitySettings(FileModel):
    """Source of the velocity."""

    # "difference" is what a drive derives from its own encoder: the difference of two samples, low-passed; it
    # lags by half a sample and the filter's time. "tachometer" measures it, with noise.
    source: Literal["difference", "tachometer"] = "difference"
    bandwidth_hz: Positive = 200.0  # first-order low-pass of the difference [Hz]
    noise_std_rad_s: NotNegative = 0.002  # white noise of the tachometer [rad/s]


class EncoderSettings(FileModel):
    """Encoders on the motor side of a gear, seen from the joint."""

    # Steps in one revolution of the joint; 2^14 counts through a gear of 50:1.
    counts_per_revolution: Number = Field(default=819_200.0, gt=0, le=1e12)
    velocity: VelocitySettings = VelocitySettings()  # source of the velocity
    # Samples per second inside the drive [Hz]; the robot reads the newest one.
    rate_hz: Number = Field(default=2000.0, gt=0, le=1e6)
    delay_s: Delay = 0.0  # from the sampling instant until a sample can be read [s]


class ArmSensorSettings(FileModel):
    """All sensors of one arm."""

    encoder: EncoderSettings = EncoderSettings()
    torque: TorqueSettings = TorqueSettings()
    force: ForceSettings = ForceSettings()


_SAME_TIME_S = 1e-9  # physics times are multiples of the step; closer than this is the same instant


class _LowPass:
    """First-order low-pass dy/dt = 2 pi f (u - y) of several signals at once, called at each step."""

    def __init__(self, bandwidth_hz: float, step_s: float) -> None:
        self._gain = 1.0 - exp(-2.0 * pi * bandwidth_hz * step_s)
        self._output: list[float] | None = None

    def filter(self, signal: Sequence[float]) -> list[float]:
        """Compute the output after one more step h; the first call starts in the steady state.

            y += (1 - exp(-2 pi f h)) (u - y),    exact for a constant input within the step

        Args:
            signal: input u of each signal, in the unit of the output.
        """
        if self._output is None:
            self._output = list(signal)
        else:
            gain = self._gain
            self._output = [y + gain * (u - y) for u, y in zip(signal, self._output, strict=True)]
        return self._output


class SensorSample(NamedTuple):
    """One sample of a device."""

    value: list[float]  # in the unit of the sensor
    sampled_at_s: float  # when the device sampled [s]
    status: Status = Status.OK  # how far to trust it


class SampledSensor(ABC):
    """A sensor that samples at its own rate and hands a sample out after its delay.

    The world shows it the true signal at every physics step; it samples at the first step at or after each of
    its sampling instants, so `sampled_at_s` is always the time of a state that existed. Above the physics
    rate, every step is a sample.

    Args:
        rate_hz: sampling rate [Hz].
        delay_s: delay from the sampling instant until a sample can be read [s].
        start_s: start of the first sampling period; a sample is taken then [s].
        phase: place of the sampling instants in the period, 0 to 1.
        low_pass: analog filter ahead of the sampling.

    Attributes:
        next_sample_s: time before which `observe` does nothing and need not be called [s]; minus infinity
            with a filter, which needs every step.
    """

    def __init__(
        self,
        rate_hz: float,
        delay_s: float,
        start_s: float,
        phase: float = 0.0,
        low_pass: _LowPass | None = None,
    ) -> None:
        self._period_s = 1.0 / rate_hz
        self._delay_s = delay_s
        self._first_instant_s = start_s + phase / rate_hz
        self._sample_s = start_s - _SAME_TIME_S
        self._low_pass = low_pass
        self.next_sample_s = -inf if low_pass else self._sample_s
        # As many as can be on their way at once, and the newest that has arrived.
        self._samples: deque[SensorSample] = deque(maxlen=floor(delay_s * rate_hz) + 3)
        self._returned_at_s: float | None = None  # time of the sample that was returned last

    @abstractmethod
    def _measure(self, time_s: float, signal: Sequence[float]) -> SensorSample:
        """Make a sample of the true signal."""

    def observe(self, time_s: float, signal: Sequence[float]) -> None:
        """Show the true signal at a physics step; it is sampled if an instant has come.

        Args:
            time_s: time of the step [s].
            signal: true signal.
        """
        if self._low_pass:
            signal = self._low_pass.filter(signal)
        if time_s < self._sample_s:
            return
        periods = floor((time_s - self._first_instant_s + _SAME_TIME_S) / self._period_s) + 1
        self._sample_s = self._first_instant_s + periods * self._period_s - _SAME_TIME_S  # the next instant
        if not self._low_pass:
            self.next_sample_s = self._sample_s
        self._samples.append(self._measure(time_s, signal))

    def read(self, time_s: float) -> SensorSample | None:
        """Return the newest sample that has arrived, stale if it was returned before; None before the first.

        Args:
            time_s: now [s].
        """
        arrived_s = time_s - self._delay_s + _SAME_TIME_S
        for sample in reversed(self._samples):
            if sample.sampled_at_s <= arrived_s:
                break
        else:
            return None
        if sample.sampled_at_s == self._returned_at_s:
            return SensorSample(sample.value, sample.sampled_at_s, Status.STALE)
        self._returned_at_s = sample.sampled_at_s
        return sample


_BLOCK = 1024


class _GaussianNoise:
    """An endless sequence of independent N(0, std^2) numbers, in the unit of the signal."""

    def __init__(self, std: float, generator: np.random.Generator) -> None:
        self._std = std
        self._generator = generator
        self._block: list[float] = []

    def add_to(self, signal: Sequence[float]) -> Sequence[float]:
        """Return a signal with the next numbers added, a different one for each value.

        Args:
            signal: values in the unit of the noise; returned itself if the noise is zero.
        """
        if not self._std:
            return signal
        if len(self._block) < len(signal):
            self._block = self._generator.normal(0.0, self._std, _BLOCK).tolist() + self._block
        draw = self._block.pop
        return [value + draw() for value in signal]


def quantize(values: Sequence[float], step: float) -> list[float]:
    """Round values to multiples of a step.

    Args:
        values: in any unit.
        step: in the same unit; 0 changes nothing.
    """
    return [round(value / step) * step for value in values] if step else list(values)


class SimulatedEncoder(SampledSensor):
    """Samples positions and velocities of all joints; see `SampledSensor`.

    The true signal is the n positions [rad] followed by the n velocities [rad/s], and a sample has the
    same form. Noise is that of a tachometer; a velocity by difference inherits the effects that are hidden in
    the positions.

    Args:
        settings: settings of the encoders.
        generator: for noise.
        start_s: start of the first sampling period [s].
        step_s: length of a physics step [s].
        effects: hidden in the positions.
    """

    def __init__(
        self,
        settings: EncoderSettings,
        generator: np.random.Generator,
        start_s: float,
        step_s: float,
        effects: Sequence[SensorHook] = (),
    ) -> None:
        super().__init__(settings.rate_hz, settings.delay_s, start_s)
        self._count_rad = 2.0 * pi / settings.counts_per_revolution
        self._counts_per_rad = 1.0 / self._count_rad
        self._by_difference = settings.velocity.source == "difference"
        self._noise = _GaussianNoise(settings.velocity.noise_std_rad_s, generator)
        sample_period_s = max(1.0 / settings.rate_hz, step_s)
        self._velocity_low_pass = _LowPass(settings.velocity.bandwidth_hz, sample_period_s)
        self._effects = effects
        self._last_s, self._last_position = -inf, list[float]()

    def _measure(self, time_s: float, signal: Sequence[float]) -> SensorSample:
        joint_count = len(signal) // 2
        position: Sequence[float] = signal[:joint_count]
        for effect in self._effects:
            position = effect.measure(time_s, position)
        per_rad, count_rad = self._counts_per_rad, self._count_rad
        counted = [round(angle * per_rad) * count_rad for angle in position]
        if not self._by_difference:
            return SensorSample([*counted, *self._noise.add_to(signal[joint_count:])], time_s)
        rate_hz = 1.0 / (time_s - self._last_s)
        last_position = self._last_position or counted
        moving = [(angle - last) * rate_hz for angle, last in zip(counted, last_position, strict=True)]
        self._last_s, self._last_position = time_s, counted
        return SensorSample(counted + self._velocity_low_pass.filter(moving), time_s)


class _Amplifier:
    """Signal chain: hidden effects before the noise, noise, effects after it, converter's steps."""

    def __init__(
        self, std: float, generator: np.random.Generator, effects: Sequence[SensorHook], resolution: float
    ) -> None:
        self._noise, self._resolution = _GaussianNoise(std, generator), resolution
        self._ahead = [effect for effect in effects if effect.ahead_of_noise]
        self._behind = [effect for effect in effects if not effect.ahead_of_noise]

    def output(self, time_s: float, signal: Sequence[float]) -> list[float]:
        """Compute one sample, rounded to the converter's steps.

        Args:
            time_s: time of the sample [s].
            signal: true values in the unit of the output.
        """
        value: Sequence[float] = signal
        for effect in self._ahead:
            value = effect.measure(time_s, value)
        value = self._noise.add_to(value)
        for effect in self._behind:
            value = effect.measure(time_s, value)
        return quantize(value, self._resolution)


class SimulatedTorqueSensor(SampledSensor):
    """Samples the torques of all drives along the joint axes, shape (n,) [N m]; see `SampledSensor`."""

    def __init__(
        self,
        settings: TorqueSettings,
        generator: np.random.Generator,
        start_s: float,
        effects: Sequence[SensorHook] = (),
    ) -> None:
        super().__init__(settings.rate_hz, settings.delay_s, start_s, settings.phase)
        self._amplifier = _Amplifier(settings.noise_std_nm, generator, effects, settings.resolution_nm)

    def _measure(self, time_s: float, signal: Sequence[float]) -> SensorSample:
        return SensorSample(self._amplifier.output(time_s, signal), time_s)


class SimulatedForceSensor(SampledSensor):
    """Samples the force along the sensor axis, shape (1,), compression positive [N]; see `SampledSensor`."""

    def __init__(
        self,
        settings: ForceSettings,
        generator: np.random.Generator,
        start_s: float,
        step_s: float,
        effects: Sequence[SensorHook] = (),
    ) -> None:
        low_pass = _LowPass(settings.bandwidth_hz, step_s) if settings.bandwidth_hz else None
        super().__init__(settings.rate_hz, settings.delay_s, start_s, low_pass=low_pass)
        self._range_n = settings.range_n
        self._amplifier = _Amplifier(settings.noise_std_n, generator, effects, settings.resolution_n)

    def _measure(self, time_s: float, signal: Sequence[float]) -> SensorSample:
        measured, range_n = self._amplifier.output(time_s, signal), self._range_n
        if abs(measured[0]) < range_n:
            return SensorSample(measured, time_s)
        return SensorSample([clip(measured[0], -range_n, range_n)], time_s, Status.SATURATED)
