"""A spring that stiffens or softens with its stretch."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class CubicStiffness(AdditiveEffect):
    """F = k3 x^3; in a contact only while pressed."""

    name = "cubic_stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "The spring gets stiffer (or softer) the further it is displaced."
    equation = "F = k3 x^3"
    source = "G. Duffing, Erzwungene Schwingungen bei veränderlicher Eigenfrequenz (1918)"
    signature = (
        "the slope of effort over position grows with displacement, equally on both sides, at any speed"
    )
    signals = ("position",)
    channels = frozenset(ChannelKind)
    gains = (
        Parameter("k3", "{effort}/{position}^3", -10000000000000.0, 10000000000000.0, (1.0, 1000000000.0)),
    )
    elastic = ("k3",)
    confused_with = {
        "exponential_stiffness": "press deeper: an exponential soon outgrows a cubic",
        "power_law_stiffness": "press deeper: a power law and a cubic part ways",
        "hunt_crossley": "press deeper: a power law and a cubic part ways",
        "layered_stiffness": "press deeper: a layer has a kink where the slope jumps, a cubic has none",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.where(data.engaged, data.position, 0.0)[:, None] ** 3
