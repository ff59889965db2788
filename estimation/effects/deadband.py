"""Small efforts are not shown."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from robot_io.types import FloatArray

SWALLOWED = "swallowed_effort"  # signal (n, 2): width of a dead band that another channel tells, its std err


class Deadband(SensorEffect):
    """reading = effort - width * sat(effort / width)."""

    name = "deadband"
    physics = "Friction or a threshold in the sensor swallows the first part of any effort."
    equation = "reading = effort - clip(effort, -width, width)"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 2: threshold"
    signature = "readings stay at zero near zero and are short by one amount elsewhere"
    signals = ("effort",)
    channels = frozenset(ChannelKind)
    inner = (Parameter("width", "{effort}", 1e-09, 10000.0, (0.001, 1.0), log=True),)
    confused_with: ClassVar[dict[str, str]] = {
        "contact_offset": "probe slowly near the surface",
        "bias": "look at both signs of effort",
        "coulomb_friction": "hold still under several loads",
    }
    linear = False

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.sense`."""
        return effort - np.clip(effort, -inner["width"], inner["width"])

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`: none within the width."""
        return np.where(np.abs(effort) > inner["width"], 1.0, 0.0)[:, None] * columns

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: shares of the largest reading."""
        peak = float(np.max(np.abs(data.effort))) or 1.0
        return tuple({"width": float(part * peak)} for part in np.geomspace(0.01, 0.4, 8))

    def suited_to(self, data: ChannelData) -> "Deadband":
        """See `Effect.suited_to`: with the width that another channel tells, if one does."""
        return _KnownDeadband(*data.context[SWALLOWED][0].tolist()) if SWALLOWED in data.context else self


class _KnownDeadband(Deadband):
    """One of this width."""

    def __init__(self, width: float, std_err: float) -> None:
        (parameter,) = Deadband.inner
        self._width = width
        self.inner = (replace(parameter, typical=(width, width), told=std_err),)  # type: ignore[misc]  # of this channel alone

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`; where nothing comes through yet, a fit must begin somewhere."""
        if np.all(np.abs(effort) <= inner["width"]):
            return columns
        return super().slope(effort, columns, data, inner)

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`."""
        return ({"width": self._width},)
