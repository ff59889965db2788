"""A stiffer layer below the surface."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from robot_io.types import FloatArray


class LayeredStiffness(AdditiveEffect):
    """F = k2 max(x - d, 0): a second spring from depth d on."""

    name = "layered_stiffness"
    physics = "Below a certain depth a second, stiffer (or softer) layer begins to carry load."
    equation = "F = k2 max(x - d, 0)"
    source = (
        "piecewise-linear (bilinear) contact stiffness; S. Timoshenko, Vibration Problems in "
        "Engineering (1937), ch. II"
    )
    signature = "the slope of force over depth jumps at one depth, the same on the way in and out"
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("k2", "{effort}/{position}", -10000000.0, 10000000.0, (10.0, 20000.0)),)
    inner = (Parameter("depth", "{position}", 0.0, 0.2, (0.001, 0.02)),)
    confused_with: ClassVar[dict[str, str]] = {
        "cubic_stiffness": "press deeper: beyond the kink a layer is straight, a cubic bends on",
        "hunt_crossley": "press deeper: beyond the kink a layer is straight, a power law bends on",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 1)."""
        return np.maximum(data.position - inner["depth"], 0.0)[:, None]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: fractions of the deepest indentation."""
        deepest = max(float(np.max(data.position, initial=0.0)), 1e-9)
        return tuple({"depth": float(part * deepest)} for part in np.linspace(0.1, 0.85, 11))
