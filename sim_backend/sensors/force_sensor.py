"""A uniaxial load cell: band limit, noise, hidden effects, resolution, range."""

from collections.abc import Sequence

import numpy as np

from robot_io.clip import clip
from robot_io.types import Status
from sim_backend.hooks import SensorEffect
from sim_backend.sensors.low_pass import LowPass
from sim_backend.sensors.noise import GaussianNoise
from sim_backend.sensors.quantise import quantise
from sim_backend.sensors.sampling import Sample, SampledSensor
from sim_backend.sensors.settings import ForceSettings


class SimulatedForceSensor(SampledSensor):
    """Samples the force along the sensor axis (1,), positive in compression [N].

    Args:
        settings: the sensor.
        generator: random numbers for its noise.
        start_s: time of its first sample [s].
        step_s: length of a physics step [s].
        effects: what is hidden in it.
    """

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
        self._resolution_n, self._range_n = settings.resolution_n, settings.range_n
        self._noise = GaussianNoise(settings.noise_std_n, generator)
        self._ahead = [effect for effect in effects if effect.ahead_of_noise]
        self._behind = [effect for effect in effects if not effect.ahead_of_noise]

    def _measure(self, time_s: float, signal: Sequence[float]) -> Sample:
        value: Sequence[float] = signal
        for effect in self._ahead:
            value = effect.measure(time_s, value)
        value = self._noise.added_to(value)
        for effect in self._behind:
            value = effect.measure(time_s, value)
        measured, range_n = quantise(value, self._resolution_n), self._range_n
        if abs(measured[0]) < range_n:
            return Sample(measured, time_s)
        return Sample([clip(measured[0], -range_n, range_n)], time_s, Status.SATURATED)
