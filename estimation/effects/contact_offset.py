"""The surface lies elsewhere than assumed."""

from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, MotionEffect, Parameter
from estimation.kinds import Kind


class ContactOffset(MotionEffect):
    """The true depth is x - offset: positive where the surface lies deeper than assumed."""

    name = "contact_offset"
    kind = Kind.CONTACT_GEOMETRY
    physics = "The object's surface lies deeper or higher than assumed."
    equation = "x_true = x - offset"
    source = "geometry of the probe and the object"
    signature = "all force-depth curves are shifted along the depth, while the force in free air is zero"
    signals = ("position",)
    channels = frozenset({ChannelKind.CONTACT})
    inner = (Parameter("offset", "{position}", -0.02, 0.02, (-1e-3, 1e-3)),)
    confused_with = {
        "bias": "record free air: a sensor's bias is there too, an offset is not",
        "adhesion": "watch the force just before contact is lost: adhesion pulls",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        return replace(data, position=data.position - inner["offset"])

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: shares of the deepest indentation, either way."""
        deepest = max(float(np.max(data.position, initial=0.0)), 1e-9)
        shares = (-0.5, -0.2, -0.08, -0.03, -0.01, 0.01, 0.03, 0.08, 0.2, 0.5)
        return tuple({"offset": share * deepest} for share in shares)
