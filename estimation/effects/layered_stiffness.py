"""A stiffer layer below the surface."""

from collections.abc import Mapping

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Errors, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray

_CLEARLY = 2.0  # standard errors
_SHOWN = 0.03  # of the press of the upper layer, that a sensor must show
_OTHER_SPRINGS = {"hunt_crossley.k", "stress_relaxation.k1"}


class LayeredStiffness(AdditiveEffect):
    """F = k2 max(x - d, 0): a second spring from depth d on."""

    name = "layered_stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "Below a certain depth a second, stiffer (or softer) layer begins to carry load."
    equation = "F = k2 max(x - d, 0)"
    source = (
        "piecewise-linear (bilinear) contact stiffness; S. Timoshenko, Vibration Problems in "
        "Engineering (1937), ch. II"
    )
    signature = "the slope of force over depth jumps at one depth, the same on the way in and out"
    signals = ("position",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("k2", "{effort}/{position}", -1e12, 1e12, (10.0, 20000.0)),)
    elastic = ("k2",)
    inner = (Parameter("depth", "{position}", 0.0, 0.2, (0.001, 0.02)),)
    confused_with = {
        "exponential_stiffness": "press deeper: beyond the kink a layer is straight",
        "cubic_stiffness": "press deeper: beyond the kink a layer is straight, a cubic bends on",
        "hunt_crossley": "press deeper: beyond the kink a layer is straight, a power law bends on",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.maximum(data.position - inner["depth"], 0.0)[:, None]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: fractions of the deepest indentation."""
        deepest = max(float(np.max(data.position, initial=0.0)), 1e-9)
        return tuple({"depth": float(part * deepest)} for part in np.linspace(0.1, 0.85, 11))

    def is_misnamed(
        self, data: ChannelData, parameters: Mapping[str, float], errors: Errors, noise: float
    ) -> bool:
        """See `Effect.is_misnamed`: one of the two layers is not seen to press back.

        Without the upper one it is a gap or a dead band, without the lower one the end of the sensor's range.
        Nor is the upper one seen where the sensor's dead band swallows next to all of its press: what is left
        is an object that begins at the kink, a surface that lies deeper. Where something else than a spring
        and its cubic is elastic too, nothing is said.
        """
        if "stiffness.k" not in parameters or _OTHER_SPRINGS & parameters.keys():
            return False
        k, k2, kink = (parameters[name] for name in ("stiffness.k", f"{self.name}.k2", f"{self.name}.depth"))
        k3, deepest = parameters.get("cubic_stiffness.k3", 0.0), float(np.max(data.position))
        upper = k * kink + k3 * kink**3
        lower = (k + k2) * (deepest - kink) + k3 * (deepest**3 - kink**3)
        shown = upper - parameters.get("deadband.width", 0.0)
        if min(shown, lower) < noise or shown < _SHOWN * upper:
            return True
        if k3 != 0.0:
            return False  # no single slope then tells what a layer carries
        known = errors()
        return not (_presses(k, known["stiffness.k"]) and _presses(k + k2, known[f"{self.name}.k2"]))


def _presses(slope: float, std_err: float) -> bool:
    """Whether a layer's slope is clearly above nothing; by its sign alone where its error is not known."""
    return slope >= (0.0 if np.isnan(std_err) else _CLEARLY * std_err)
