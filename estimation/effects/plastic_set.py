"""The object keeps a dent."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, MotionEffect, Parameter
from estimation.signals.runwise import running_max


class PlasticSet(MotionEffect):
    """The surface sinks by a share of the deepest indentation so far: x_true = x - share * max(x so far)."""

    name = "plastic_set"
    physics = "Part of the indentation stays: on the way out the object is met later than on the way in."
    equation = "x_true = x - share max_t(x)"
    source = "permanent set in indentation; K. L. Johnson, Contact Mechanics (1985), ch. 6"
    signature = (
        "force reaches zero at a depth above zero on the way out, and the next press on the spot begins there"
    )
    channels = frozenset({ChannelKind.CONTACT})
    inner = (Parameter("share", "1", 0.0, 0.9, (0.02, 0.5)),)
    confused_with: ClassVar[dict[str, str]] = {
        "stress_relaxation": "wait and press again: a set stays, relaxation recovers",
        "adhesion": "press twice on one spot: a set moves the second touch",
        "hysteresis": "press twice on one spot: the sensor has no memory of the depth",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        """See `MotionEffect.move`."""
        deepest = np.maximum(running_max(data.position, data.run), 0.0)
        return replace(data, position=data.position - inner["share"] * deepest)
