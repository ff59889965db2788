"""The sensor reaches the end of its range."""

from collections.abc import Mapping

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Errors, Inner, Parameter, SensorEffect
from estimation.kinds import Kind
from robot_io.types import FloatArray

_NOISE, _OF_THOSE = 4.0, 0.05  # times the noise, and share of the readings beyond the limit


class Saturation(SensorEffect):
    """reading = clip(effort, -limit, limit)."""

    name = "saturation"
    kind = Kind.SENSOR_STATICS
    physics = "Beyond its range the sensor shows the end of the range."
    equation = "reading = clip(effort, -limit, limit)"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 2: span"
    signature = "the largest readings are cut off flat at one value"
    signals = ("effort",)
    channels = frozenset(ChannelKind)
    inner = (Parameter("limit", "{effort}", 1e-06, 100000.0, (0.1, 100.0), log=True),)
    confused_with = {
        "layered_stiffness": "press less: below the limit nothing is missing",
        "cubic_stiffness": "press less: below the limit nothing is missing",
    }
    linear = False

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return np.clip(effort, -inner["limit"], inner["limit"])

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`: none beyond the limit."""
        return np.where(np.abs(effort) < inner["limit"], 1.0, 0.0)[:, None] * columns

    def is_misnamed(
        self, data: ChannelData, parameters: Mapping[str, float], errors: Errors, noise: float
    ) -> bool:
        """See `Effect.is_misnamed`: readings go on beyond the limit, by more than noise."""
        above = np.abs(data.effort) - parameters[f"{self.name}.limit"]
        return bool(np.sum(above > _NOISE * noise) > _OF_THOSE * np.sum(above > 0.0))

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: shares of the largest reading."""
        peak = float(np.max(np.abs(data.effort))) or 1.0
        return tuple({"limit": float(part * peak)} for part in (0.55, 0.7, 0.8, 0.88, 0.94, 0.97, 0.99))
