"""Friction that builds up over a short path after each reversal, and stays at rest."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Errors, Inner, Parameter
from estimation.kinds import Kind
from estimation.signals.runwise import direction, smooth_jitter
from robot_io.types import FloatArray

_PLAIN = 1e-3  # of its energy, that plain friction leaves where the path is too short to be seen


class PreslidingFriction(AdditiveEffect):
    """effort = f s; s goes to the sign of motion over the path `presliding`, and keeps its value at rest."""

    name = "presliding_friction"
    kind = Kind.FRICTION
    physics = "Asperities and cables stretch like springs before they slide, and stay stretched at rest."
    equation = "effort = f s, ds/dq = (1 - s sign(v))/presliding, s = 0 at first"
    source = "P. R. Dahl, A Solid Friction Model, Aerospace Corp. TOR-158 (1968)"
    signature = "after a reversal effort turns over a path, not at a speed; at rest it keeps its value"
    signals: ClassVar[tuple[str, ...]] = ("direction", "past motion")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains: ClassVar[tuple[Parameter, ...]] = (Parameter("force", "{effort}", 0.0, 1e12, (0.001, 50.0)),)
    inner = (Parameter("presliding", "{position}", 1e-9, 10.0, (1e-4, 0.1), log=True),)
    path = "presliding"
    confused_with = {
        "coulomb_friction": "stop and creep back and forth: a path, not a speed, counts",
        "load_dependent_presliding": "repeat with another load",
        "bouc_wen_hysteresis": "reverse half way: the curves of Dahl's friction are exponentials",
        "backlash": "reverse slowly: through a gap the effort is missing, and comes back",
        "hysteresis": "reverse slowly at several loads",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        way = smooth_jitter(data.position, data.time_s, data.run)
        return direction(way, data.run, inner["presliding"])[:, None]

    def is_misnamed(
        self, data: ChannelData, parameters: Mapping[str, float], errors: Errors, noise: float
    ) -> bool:
        """See `Effect.is_misnamed`: over a path too short to be seen it is friction that just turns round."""
        (path,) = self.inner
        built, plain = (
            self.columns(data, {path.name: length})
            for length in (parameters[f"{self.name}.{path.name}"], path.lower)
        )
        return float(np.sum((built - plain) ** 2)) < _PLAIN * float(np.sum(built**2))

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a thousandth to a third of the range of motion."""
        span = float(np.ptp(data.position)) or 1.0
        return tuple({"presliding": float(part * span)} for part in np.geomspace(1e-3, 0.3, 9))
