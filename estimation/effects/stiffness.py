"""A linear spring."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class Stiffness(AdditiveEffect):
    """F = k x; in a contact the spring pushes only while it is pressed (x > 0)."""

    name = "stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "A spring pushes back in proportion to how far it is displaced."
    equation = "F = k x"
    source = "R. Hooke, De Potentia Restitutiva (1678); the elastic half of the Kelvin-Voigt body"
    signature = "effort grows in proportion to displacement, at any speed and on the way in as on the way out"
    signals = ("position",)
    channels = frozenset(ChannelKind)
    gains = (Parameter("k", "{effort}/{position}", 0.0, 1e12, (10.0, 2e4)),)
    elastic = ("k",)
    confused_with = {
        "cubic_stiffness": "press to several depths: a linear spring has the same slope everywhere",
        "contact_offset": "press to several depths from a known surface",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.where(data.engaged, data.position, 0.0)[:, None]
