"""The encoder, the torque sensor and the force sensor of the simulated arm."""

from collections.abc import Sequence
from math import inf, pi

import numpy as np

from robot_io.clip import clip
from robot_io.types import Status
from sim_backend.hooks import SensorEffect
from sim_backend.sensors.sampling import GaussianNoise, LowPass, Sample, SampledSensor, quantise
from sim_backend.sensors.settings import EncoderSettings, ForceSettings, TorqueSettings


class SimulatedEncoder(SampledSensor):
    """Samples positions and velocities of all joints; see `SampledSensor`.

    The true signal is the n positions [rad] followed by the n velocities [rad/s], and so is a sample. Noise
    is a tachometer's; a velocity by difference inherits the effects that are hidden in the positions.
    """

    def __init__(
        self,
        settings: EncoderSettings,
        generator: np.random.Generator,
        start_s: float,
        step_s: float,
        effects: Sequence[SensorEffect] = (),
    ) -> None:
        super().__init__(settings.rate_hz, settings.delay_s, start_s)
        self._count_rad = 2.0 * pi / settings.counts_per_revolution
        self._counts_per_rad = 1.0 / self._count_rad
        self._by_difference = settings.velocity.source == "difference"
        self._noise = GaussianNoise(settings.velocity.noise_std_rad_s, generator)
        sample_period_s = max(1.0 / settings.rate_hz, step_s)
        self._velocity_low_pass = LowPass(settings.velocity.bandwidth_hz, sample_period_s)
        self._effects = effects
        self._before_s, self._before = -inf, list[float]()

    def _measure(self, time_s: float, signal: Sequence[float]) -> Sample:
        joint_count = len(signal) // 2
        position: Sequence[float] = signal[:joint_count]
        for effect in self._effects:
            position = effect.measure(time_s, position)
        per_rad, count_rad = self._counts_per_rad, self._count_rad
        counted = [round(angle * per_rad) * count_rad for angle in position]
        if not self._by_difference:
            return Sample([*counted, *self._noise.added_to(signal[joint_count:])], time_s)
        rate_hz = 1.0 / (time_s - self._before_s)
        before = self._before or counted
        moving = [(now - then) * rate_hz for now, then in zip(counted, before, strict=True)]
        self._before_s, self._before = time_s, counted
        return Sample(counted + self._velocity_low_pass.filter(moving), time_s)


class _Amplifier:
    """Hidden effects ahead of the noise, the noise, effects behind it, and the converter's steps."""

    def __init__(self, noise: GaussianNoise, effects: Sequence[SensorEffect], resolution: float) -> None:
        self._noise, self._resolution = noise, resolution
        self._ahead = [effect for effect in effects if effect.ahead_of_noise]
        self._behind = [effect for effect in effects if not effect.ahead_of_noise]

    def output(self, time_s: float, signal: Sequence[float]) -> list[float]:
        value: Sequence[float] = signal
        for effect in self._ahead:
            value = effect.measure(time_s, value)
        value = self._noise.added_to(value)
        for effect in self._behind:
            value = effect.measure(time_s, value)
        return quantise(value, self._resolution)


class SimulatedTorqueSensor(SampledSensor):
    """Samples the torques of all drives, positive along the joint axes (n) [N m]; see `SampledSensor`."""

    def __init__(
        self,
        settings: TorqueSettings,
        generator: np.random.Generator,
        start_s: float,
        effects: Sequence[SensorEffect] = (),
    ) -> None:
        super().__init__(settings.rate_hz, settings.delay_s, start_s, settings.phase)
        noise = GaussianNoise(settings.noise_std_nm, generator)
        self._amplifier = _Amplifier(noise, effects, settings.resolution_nm)

    def _measure(self, time_s: float, signal: Sequence[float]) -> Sample:
        return Sample(self._amplifier.output(time_s, signal), time_s)


class SimulatedForceSensor(SampledSensor):
    """Samples the force along the sensor axis (1,), positive in compression [N]; see `SampledSensor`."""

    def __init__(
        self,
        settings: ForceSettings,
        generator: np.random.Generator,
        start_s: float,
        step_s: float,
        effects: Sequence[SensorEffect] = (),
    ) -> None:
        low_pass = LowPass(settings.bandwidth_hz, step_s) if settings.bandwidth_hz else None
        super().__init__(settings.rate_hz, settings.delay_s, start_s, low_pass=low_pass)
        self._range_n = settings.range_n
        noise = GaussianNoise(settings.noise_std_n, generator)
        self._amplifier = _Amplifier(noise, effects, settings.resolution_n)

    def _measure(self, time_s: float, signal: Sequence[float]) -> Sample:
        measured, range_n = self._amplifier.output(time_s, signal), self._range_n
        if abs(measured[0]) < range_n:
            return Sample(measured, time_s)
        return Sample([clip(measured[0], -range_n, range_n)], time_s, Status.SATURATED)
