"""Small efforts are not shown."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from estimation.kinds import Kind
from robot_io.types import FloatArray


class Deadband(SensorEffect):
    """reading = effort - width * sat(effort / width)."""

    name = "deadband"
    kind = Kind.SENSOR_STATICS
    physics = "Friction or a threshold in the sensor swallows the first part of any effort."
    equation = "reading = effort - clip(effort, -width, width)"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 2: threshold"
    signature = "readings stay at zero near zero and are short by one amount elsewhere"
    signals = ("effort",)
    channels = frozenset(ChannelKind)
    inner = (Parameter("width", "{effort}", 1e-09, 10000.0, (0.001, 1.0), log=True),)
    confused_with = {
        "contact_offset": "probe slowly near the surface",
        "bias": "look at both signs of effort",
        "coulomb_friction": "hold still under several loads",
    }
    linear = False

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return effort - np.clip(effort, -inner["width"], inner["width"])

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`: none within the width."""
        return np.where(np.abs(effort) > inner["width"], 1.0, 0.0)[:, None] * columns

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: shares of the largest reading."""
        peak = float(np.max(np.abs(data.effort))) or 1.0
        return tuple({"width": float(part * peak)} for part in np.geomspace(0.01, 0.4, 8))
