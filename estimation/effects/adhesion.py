"""The object sticks to the tool."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from estimation.signals.runwise import running_max
from robot_io.types import FloatArray


class Adhesion(AdditiveEffect):
    """F = -f while in contact, fading as exp(x / reach) where the tool has left the surface again (x < 0)."""

    name = "adhesion"
    kind = Kind.CONTACT_GEOMETRY
    physics = "Once touched, the object pulls the tool back, and lets go only beyond the surface."
    equation = "F = -f s, s = 1 for x > 0, exp(x/reach) for x < 0 after contact, 0 before"
    source = "B. V. Derjaguin, V. M. Muller, Yu. P. Toporov, J. Colloid Interface Sci. 53 (1975)"
    signature = "on leaving the object the force goes below that of free air before it returns"
    signals = ("position", "past motion")
    channels = frozenset({ChannelKind.CONTACT})
    one_sided = False
    gains = (Parameter("force", "{effort}", 0.0, 1e12, (0.05, 5.0)),)
    inner = (Parameter("reach", "{position}", 1e-05, 0.02, (0.0001, 0.005), log=True),)
    confused_with = {
        "contact_offset": "retract slowly beyond the surface: only adhesion pulls there",
        "bias": "record free air before the touch: a bias is there too",
        "dry_friction": "retract slowly beyond the surface: friction ends with the contact",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        touched = running_max(data.engaged.astype(np.float64), data.run)
        neck = np.exp(np.minimum(data.position, 0.0) / inner["reach"])
        return -(touched * neck)[:, None]
