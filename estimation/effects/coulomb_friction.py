"""Friction that does not depend on speed."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class CoulombFriction(AdditiveEffect):
    """effort = f tanh(v / transition): a constant against the motion."""

    name = "coulomb_friction"
    kind = Kind.FRICTION
    physics = "Dry surfaces rub with a constant force against the motion."
    equation = "effort = f tanh(v/transition)"
    source = (
        "C. A. Coulomb, Théorie des machines simples (1785); smoothed as in Andersson et al., "
        "Tribology Int. 40 (2007)"
    )
    signature = "effort jumps where the velocity changes sign, by the same amount at any speed and position"
    signals: ClassVar[tuple[str, ...]] = ("direction",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains: ClassVar[tuple[Parameter, ...]] = (Parameter("force", "{effort}", 0.0, 1e12, (0.001, 50.0)),)
    inner: ClassVar[tuple[Parameter, ...]] = (
        Parameter("transition", "{position}/s", 1e-09, 1e3, (0.0001, 0.05), log=True),
    )
    confused_with = {
        "position_dependent_friction": "move over a wide range",
        "presliding_friction": "stop and creep back and forth: a path, not a speed, counts",
        "stribeck_friction": "move very slowly: Stribeck friction rises towards zero speed",
        "load_dependent_friction": "repeat with another load: Coulomb friction stays",
        "asymmetric_friction": "let the joint rest: a bias beside Coulomb friction stays",
        "hysteresis": "reverse slowly at several loads",
        "backlash": "reverse slowly: through a gap the effort is missing, and comes back",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.tanh(data.velocity / inner["transition"])[:, None]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: smoothing at a small share of the usual speed."""
        speed = float(np.sqrt(np.mean(data.velocity**2))) or 1.0
        return tuple({"transition": part * speed} for part in (0.003, 0.01, 0.03, 0.08))
