"""The nonlinear contact of Hunt and Crossley."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from robot_io.types import FloatArray


class HuntCrossley(AdditiveEffect):
    """F = k x^n + b x^n v for x > 0: spring and damper both grow with depth, so that touch brings no jump."""

    name = "hunt_crossley"
    physics = "Contact grows with depth, and spring and damping grow with the contact."
    equation = "F = k x^n + b x^n v"
    source = (
        "K. H. Hunt, F. R. E. Crossley, Coefficient of Restitution Interpreted as Damping in Vibroimpact, "
        "J. Appl. Mech. 42 (1975)"
    )
    signature = "effort curves upwards with depth, and the difference between in and out grows with depth too"
    signals = ("position", "velocity")
    channels = frozenset({ChannelKind.CONTACT})
    gains = (
        Parameter("k", "{effort}/{position}^n", 0.0, 1e12, (10.0, 1e6)),
        Parameter("b", "{effort} s/{position}^(n+1)", 0.0, 1e12, (1.0, 1e6)),
    )
    elastic = ("k",)
    essential = ("b",)
    inner = (Parameter("n", "1", 0.5, 4.0, (1.0, 2.0)),)
    confused_with: ClassVar[dict[str, str]] = {
        "power_law_stiffness": "press at two speeds: its damping grows with depth",
        "cubic_stiffness": "press deeper: a power law and a cubic part ways",
        "layered_stiffness": "press deeper: layers have a kink, a power law has none",
        "contact_offset": "find the surface by a slow touch: an offset bends the curve near the surface only",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        power = np.maximum(data.position, 0.0) ** inner["n"]
        return np.column_stack([power, power * data.velocity])
