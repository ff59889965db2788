"""The sensor has coarse steps."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from robot_io.types import FloatArray


class Quantisation(SensorEffect):
    """reading = step * round(effort / step)."""

    name = "quantisation"
    physics = "The converter knows only whole steps."
    equation = "reading = step round(effort/step)"
    source = "B. Widrow, I. Kollár, Quantization Noise (2008)"
    signature = "readings take few values, with flat treads between jumps"
    channels = frozenset(ChannelKind)
    inner = (Parameter("step", "{effort}", 1e-09, 10000.0, (0.001, 1.0), log=True),)
    confused_with: ClassVar[dict[str, str]] = {
        "deadband": "vary the effort slowly over several steps",
        "saturation": "vary the effort slowly over several steps",
    }
    linear = False

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.sense`."""
        return inner["step"] * np.round(effort / inner["step"])

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: the mean distance between neighbouring readings, of all that are there.

        A single distance would not do: readings that are rounded once more lie at uneven distances.
        """
        levels = np.unique(data.effort)
        if len(levels) < 2:
            return ({"step": 1.0},)
        apart = np.diff(levels)
        count = np.sum(np.round(apart / np.median(apart)))
        return ({"step": max(float(np.ptp(levels) / max(count, 1.0)), 1e-9)},)

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`: on average over many steps, one."""
        return columns
