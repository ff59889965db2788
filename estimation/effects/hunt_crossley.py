"""The nonlinear contact of Hunt and Crossley."""

from collections.abc import Mapping

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Errors, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class HuntCrossley(AdditiveEffect):
    """F = k x^n + b x^n v for x > 0: spring and damper both grow with depth, so that touch brings no jump."""

    name = "hunt_crossley"
    kind = Kind.RATE_DEPENDENCE
    also = frozenset({Kind.ELASTIC_SHAPE})
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
    confused_with = {
        "power_law_stiffness": "press at two speeds: its damping grows with depth",
        "cubic_stiffness": "press deeper: a power law and a cubic part ways",
        "layered_stiffness": "press deeper: layers have a kink, a power law has none",
        "contact_offset": "find the surface by a slow touch: an offset bends the curve near the surface only",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        power = np.maximum(data.position, 0.0) ** inner["n"]
        return np.column_stack([power, power * data.velocity])

    def is_misnamed(
        self, data: ChannelData, parameters: Mapping[str, float], errors: Errors, noise: float
    ) -> bool:
        """See `Effect.is_misnamed`: the damper shows a power of the depth that the spring does not have."""
        k, b, n = (parameters[f"{self.name}.{p.name}"] for p in (*self.gains, *self.inner))
        depth = np.maximum(data.position, 0.0)
        spring, damper = (_bent(depth**n * by, depth * by) for by in (np.ones(len(data)), data.velocity))
        return bool(abs(b) * damper > noise > abs(k) * spring)


def _bent(signal: FloatArray, straight: FloatArray) -> float:
    """Root mean square of a signal (n,) less what is proportional to another."""
    share = float(signal @ straight) / max(float(straight @ straight), 1e-300)
    return float(np.sqrt(np.mean((signal - share * straight) ** 2)))
