"""Rubbing between tool and object."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.signals.blocks import stretches
from estimation.signals.runwise import direction, steadied
from robot_io.types import FloatArray


class DryFriction(AdditiveEffect):
    """F = f s; the direction of motion s takes a short path to turn round, and stays at rest.

    Each touch begins unstrained, s = 0: what rubs has nothing to hold on to before.
    """

    name = "dry_friction"
    physics = "Tool and object, or the layers of the object, rub with a force that does not depend on speed."
    equation = "F = f s, ds/dx = (1 - s sign(v))/presliding while pressed, s = 0 at touch"
    source = "P. R. Dahl, A Solid Friction Model, Aerospace Corp. TOR-158 (1968)"
    signature = (
        "force is higher by a constant while moving in than while moving out at the same depth, at any speed"
    )
    signals = ("direction", "past motion")
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("force", "{effort}", 0.0, 1000.0, (0.05, 5.0)),)
    inner = (Parameter("presliding", "{position}", 1e-07, 0.01, (1e-06, 0.001), log=True),)
    confused_with: ClassVar[dict[str, str]] = {
        "bouc_wen_hysteresis": "reverse half way: the curves of Dahl's friction are exponentials",
        "damping": "probe at two speeds: friction does not grow with speed",
        "hysteresis": "press a spring alone: the sensor keeps its hysteresis there",
        "adhesion": "retract slowly beyond the surface",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 1)."""
        touch = stretches(data.engaged, data.run)
        way = steadied(data.position, data.time_s, data.run)
        s = direction(way, touch, inner["presliding"])
        return np.where(data.engaged, s, 0.0)[:, None]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a ten-thousandth to a tenth of the depth."""
        depth = max(float(np.max(data.position, initial=0.0)), 1e-9)
        return tuple({"presliding": float(part * depth)} for part in np.geomspace(1e-3, 1e-1, 5))
