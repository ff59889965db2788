"""What the drives say about their torque: noise, hidden effects, resolution."""

from collections.abc import Sequence

import numpy as np

from sim_backend.hooks import SensorEffect
from sim_backend.sensors.noise import GaussianNoise
from sim_backend.sensors.quantise import quantise
from sim_backend.sensors.sampling import Sample, SampledSensor
from sim_backend.sensors.settings import TorqueSettings


class SimulatedTorqueSensor(SampledSensor):
    """Samples the torques of all drives, positive along the joint axes (n) [N m].

    Args:
        settings: the sensors.
        generator: random numbers for their noise.
        start_s: start of the first sampling period [s].
        effects: what is hidden in them.
    """

    def __init__(
        self,
        settings: TorqueSettings,
        generator: np.random.Generator,
        start_s: float,
        effects: Sequence[SensorEffect] = (),
    ) -> None:
        super().__init__(settings.rate_hz, settings.delay_s, start_s, settings.phase)
        self._resolution_nm = settings.resolution_nm
        self._noise = GaussianNoise(settings.noise_std_nm, generator)
        self._ahead = [effect for effect in effects if effect.ahead_of_noise]
        self._behind = [effect for effect in effects if not effect.ahead_of_noise]

    def _measure(self, time_s: float, signal: Sequence[float]) -> Sample:
        value: Sequence[float] = signal
        for effect in self._ahead:
            value = effect.measure(time_s, value)
        value = self._noise.added_to(value)
        for effect in self._behind:
            value = effect.measure(time_s, value)
        return Sample(quantise(value, self._resolution_nm), time_s)
