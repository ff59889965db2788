"""Friction that is highest just above rest."""

from collections.abc import Mapping

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Errors, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray

# Of the rise, that friction must really exceed its level at speed by. By the equation that takes a speed of
# the rise three to four times that of the transition (twice, for a rise far larger than the level).
_SEEN = 0.5


class StribeckFriction(AdditiveEffect):
    """effort = (fc + (fs - fc) exp(-(v/vs)^2)) tanh(v / transition); gains: fc and the rise fs - fc."""

    name = "stribeck_friction"
    kind = Kind.FRICTION
    physics = "At low speed the lubricant film breaks down and friction rises."
    equation = "effort = (fc + rise exp(-(v/vs)^2)) tanh(v/transition)"
    source = (
        "R. Stribeck, VDI-Zeitschrift 46 (1902); B. Armstrong-Hélouvry, Control of Machines with "
        "Friction (1991)"
    )
    signature = "effort falls with rising speed just after each reversal, then levels off"
    signals = ("velocity", "direction")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (
        Parameter("coulomb", "{effort}", 0.0, 1e12, (0.001, 50.0)),
        Parameter("rise", "{effort}", -1e12, 1e12, (0.001, 50.0)),
    )
    essential = ("rise",)
    inner = (
        Parameter("speed", "{position}/s", 1e-09, 10.0, (0.001, 1.0), log=True),
        Parameter("transition", "{position}/s", 1e-09, 1e3, (0.0001, 0.05), log=True),
    )
    confused_with = {
        "coulomb_friction": "move very slowly, and at several speeds",
        "viscous_friction": "move very slowly, and at several speeds",
        "asymmetric_friction": "move equally in both directions",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        sliding = np.tanh(data.velocity / inner["transition"])
        return np.column_stack([sliding, sliding * np.exp(-((data.velocity / inner["speed"]) ** 2))])

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: shares of the usual speed."""
        usual = float(np.sqrt(np.mean(data.velocity**2))) or 1.0
        return tuple(
            {"speed": float(part * usual), "transition": float(share * usual)}
            for part in np.geomspace(0.04, 1.2, 6)
            for share in (0.003, 0.01, 0.03)
        )

    def is_misnamed(
        self, data: ChannelData, parameters: Mapping[str, float], errors: Errors, noise: float
    ) -> bool:
        """See `Effect.is_misnamed`: friction does not rise, since all of the rise is within the transition.

        What is left then is Coulomb friction, whose transition has a shape of its own.
        """
        level, rise, speed, transition = (
            parameters[f"{self.name}.{p.name}"] for p in (*self.gains, *self.inner)
        )
        v = np.linspace(0.0, 3.0 * (speed + transition), 500)
        friction = (level + rise * np.exp(-((v / speed) ** 2))) * np.tanh(v / transition)
        return float(friction.max()) - level < _SEEN * abs(rise)
