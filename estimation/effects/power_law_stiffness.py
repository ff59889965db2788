"""A spring whose force grows with a power of its stretch."""

from collections.abc import Mapping

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Errors, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray

_STRAIGHT = 0.1  # from a power of one, within which the law is a straight line


class PowerLawStiffness(AdditiveEffect):
    """F = k |x|^n sign(x), beside whatever other stiffness there is; in a contact only while pressed.

    With n = 1.5 it is Hertz's contact of a sphere, with n = 2 Sneddon's of a cone; below 1 it softens, as
    rubber does in tension (L. R. G. Treloar, The Physics of Rubber Elasticity (1975)).
    """

    name = "power_law_stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = (
        "The more it is pressed the more of the object carries, or the less; its force bends with depth."
    )
    equation = "F = k |x|^n sign(x)"
    source = (
        "H. Hertz, J. reine angew. Mathematik 92 (1882): n = 3/2; I. N. Sneddon, Int. J. Engineering Sci. 3 "
        "(1965): n by the shape of the indenter"
    )
    signature = "effort over position is a straight line on logarithmic paper, the same at any speed"
    signals = ("position",)
    channels = frozenset(ChannelKind)
    gains = (Parameter("k", "{effort}/{position}^n", 0.0, 1e40, (10.0, 1e12)),)
    elastic = ("k",)
    inner = (Parameter("n", "1", 0.3, 6.0, (0.4, 4.0)),)
    confused_with = {
        "cubic_stiffness": "press deeper: a power law and a cubic part ways",
        "exponential_stiffness": "press deeper: an exponential soon outgrows any power",
        "hunt_crossley": "press at two speeds: its damping grows with depth",
        "layered_stiffness": "press deeper: layers have a kink, a power law has none",
        "contact_offset": "find the surface by a slow touch: an offset bends the curve near the surface only",
    }

    def is_misnamed(
        self, data: ChannelData, parameters: Mapping[str, float], errors: Errors, noise: float
    ) -> bool:
        """See `Effect.is_misnamed`: a power of about one is a straight spring."""
        return abs(parameters[f"{self.name}.n"] - 1.0) < _STRAIGHT

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        pressed = np.where(data.engaged, data.position, 0.0)
        return (np.sign(pressed) * np.abs(pressed) ** inner["n"])[:, None]
