"""Friction whose level varies with position."""

from itertools import product

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class PositionDependentFriction(AdditiveEffect):
    """effort = (f + s sin(n q) + c cos(n q)) tanh(v / transition).

    Periodic with n = 1 once a turn (an eccentric seal, a bent shaft) or faster; with less than a wave within
    the range of motion it is any friction that varies smoothly along it.
    """

    name = "position_dependent_friction"
    kind = Kind.FRICTION
    physics = "Eccentric gears, bent guides and worn tracks rub more at some places than at others."
    equation = "effort = (level + sine sin(n q) + cosine cos(n q)) tanh(v/transition)"
    source = "B. Armstrong-Hélouvry, Control of Machines with Friction (1991), ch. 5: friction by position"
    signature = "the difference between the two directions of motion varies with position, at any speed"
    signals = ("position", "direction")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (
        Parameter("level", "{effort}", 0.0, 1e12, (0.001, 50.0)),
        Parameter("sine", "{effort}", -1e12, 1e12, (0.001, 5.0)),
        Parameter("cosine", "{effort}", -1e12, 1e12, (0.001, 5.0)),
    )
    essential = ("sine", "cosine")
    inner = (
        Parameter("cycles", "1/{position}", 1e-3, 1e5, (0.5, 10.0), log=True),
        Parameter("transition", "{position}/s", 1e-9, 1e3, (1e-4, 0.05), log=True),
    )
    confused_with = {
        "torque_ripple": "compare both directions: ripple has one sign, friction turns with the motion",
        "load_dependent_friction": "repeat with another load at the same places",
        "coulomb_friction": "move over a wide range",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        sliding = np.tanh(data.velocity / inner["transition"])
        angle = inner["cycles"] * data.position
        return np.column_stack([sliding, sliding * np.sin(angle), sliding * np.cos(angle)])

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from half a wave to ten within the range of motion."""
        span = float(np.ptp(data.position)) or 1.0
        speed = float(np.sqrt(np.mean(data.velocity**2))) or 1.0
        waves = product((0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0), (0.01, 0.05))
        return tuple(
            {"cycles": float(2.0 * np.pi * count / span), "transition": float(share * speed)}
            for count, share in waves
        )
