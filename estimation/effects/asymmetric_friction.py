"""Friction that differs between the two directions."""

import numpy as np

from estimation.channel import ChannelData
from estimation.effect import Inner, Parameter
from estimation.effects.coulomb_friction import CoulombFriction
from estimation.kinds import Kind
from robot_io.types import FloatArray


class AsymmetricFriction(CoulombFriction):
    """effort = f+ for v > 0, -f- for v < 0, plus viscous parts d+ v and d- v of their own."""

    name = "asymmetric_friction"
    kind = Kind.FRICTION
    physics = "Gears and seals rub differently forwards and backwards."
    equation = "effort = f+ (v>0) - f- (v<0) + d+ v (v>0) + d- v (v<0)"
    source = "B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994), sec. 2"
    signature = "the jump at reversal and the rise with speed differ between the two directions"
    signals = ("velocity", "direction")
    gains = (
        Parameter("forward", "{effort}", 0.0, 1e12, (0.001, 50.0)),
        Parameter("backward", "{effort}", 0.0, 1e12, (0.001, 50.0)),
        Parameter("viscous_forward", "{effort} s/{position}", -1e12, 1e12, (0.001, 50.0)),
        Parameter("viscous_backward", "{effort} s/{position}", -1e12, 1e12, (0.001, 50.0)),
    )
    confused_with = {
        "bias": "let the joint rest: a bias stays, friction does not push",
        "coulomb_friction": "move equally in both directions",
    }
    parts = ("coulomb_friction", "bias")

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        direction = np.tanh(data.velocity / inner["transition"])
        forward, backward = np.maximum(direction, 0.0), np.minimum(direction, 0.0)  # at rest nothing pushes
        return np.column_stack([forward, backward, forward * data.velocity, -backward * data.velocity])

    def simpler(self, columns: FloatArray) -> FloatArray:
        """See `Effect.simpler`: alike in both directions beside a bias, which differs at rest alone."""
        both = np.column_stack([columns[:, 0] + columns[:, 1], columns[:, 2] + columns[:, 3]])
        return np.column_stack([both, np.ones(len(both))])
