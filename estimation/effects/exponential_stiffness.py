"""A spring that stiffens exponentially, as soft tissue does."""

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import AdditiveEffect, Inner, Parameter
from palpate.estimation.kinds import Kind
from palpate.robot_io.types import FloatArray

_STEEPEST = 50.0  # b |x| beyond which nothing is computed
_STARTS = (0.5, 1.0, 2.0, 4.0, 7.0, 12.0)  # b times the largest |x|


class ExponentialStiffness(AdditiveEffect):
    """F = a (exp(b |x|) - 1 - b |x|) sign(x): what a fibrous tissue adds to the straight line of its toe.

    The straight part, a b x of Fung's law, is left to the spring beside.
    """

    name = "exponential_stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "Fibres straighten one after the other, so that stiffness grows with the force itself."
    equation = "F = a (exp(b |x|) - 1 - b |x|) sign(x)"
    source = "Y. C. Fung, Am. J. Physiology 213 (1967): elasticity of soft tissues in simple elongation"
    signature = "the slope of effort over position is a straight line over the effort, at any speed"
    signals = ("position",)
    channels = frozenset(ChannelKind)
    gains = (Parameter("a", "{effort}", 0.0, 1e12, (1e-4, 10.0)),)
    elastic = ("a",)
    inner = (Parameter("b", "1/{position}", 1e-3, 1e9, (10.0, 1000.0), log=True),)
    confused_with = {
        "power_law_stiffness": "press deeper: an exponential soon outgrows any power",
        "cubic_stiffness": "press deeper: an exponential soon outgrows a cubic",
        "layered_stiffness": "press deeper: layers have a kink, an exponential has none",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        pressed = np.where(data.engaged, data.position, 0.0)
        steep = np.minimum(inner["b"] * np.abs(pressed), _STEEPEST)
        return np.asarray(np.sign(pressed) * (np.expm1(steep) - steep))[:, None]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from hardly bent to steep within the range of motion."""
        deepest = float(np.max(np.abs(data.position), initial=0.0)) or 1.0
        return tuple({"b": float(np.clip(steep / deepest, 1e-3, 1e9))} for steep in _STARTS)
