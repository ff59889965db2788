"""The sensor reads differently on the way up and down."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from estimation.signals.runwise import play
from robot_io.types import FloatArray


class Hysteresis(SensorEffect):
    """reading = play(effort, width): it follows after a gap of twice the width is crossed."""

    name = "hysteresis"
    physics = "Inner friction of the sensor holds its reading back at each reversal of the effort."
    equation = "reading = play(effort, width)"
    source = "M. A. Krasnoselskii, A. V. Pokrovskii, Systems with Hysteresis (1989): play operator"
    signature = "readings are low while the effort rises and high while it falls, at any speed"
    channels = frozenset(ChannelKind)
    inner = (Parameter("width", "{effort}", 1e-09, 10000.0, (0.001, 1.0), log=True),)
    confused_with: ClassVar[dict[str, str]] = {
        "backlash": "reverse slowly at several loads: a gap is crossed in position, a hysteresis in effort",
        "dry_friction": "reverse slowly at several depths",
        "coulomb_friction": "reverse slowly at several loads",
        "damping": "probe at two speeds",
    }
    linear = False

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.sense`."""
        return play(effort, data.run, inner["width"])

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`: while the reading is held, that of the moment when it last followed."""
        reading = self.sense(effort, data, inner)
        held = np.abs(effort - reading) < inner["width"] * (1.0 - 1e-9)
        held &= np.append(False, np.diff(data.run) == 0)
        return columns[np.maximum.accumulate(np.where(held, 0, np.arange(len(effort))))]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: shares of the largest reading."""
        peak = float(np.max(np.abs(data.effort))) or 1.0
        return tuple({"width": float(part * peak)} for part in np.geomspace(0.01, 0.3, 7))
