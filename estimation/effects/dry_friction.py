"""Rubbing between tool and object."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from estimation.signals.blocks import number_stretches
from estimation.signals.runwise import direction, smooth_jitter
from robot_io.types import FloatArray


class DryFriction(AdditiveEffect):
    """F = f s; the direction of motion s takes a short path to turn round, and stays at rest.

    Each touch begins unstrained, s = 0: what rubs has nothing to hold on to before. Slower than `transition`,
    a film between the surfaces gives way, and s goes to less than the sign of the motion. With the shortest
    path that may be, there is nothing but the film: s = tanh(v/transition), also at rest.
    """

    name = "dry_friction"
    kind = Kind.FRICTION
    physics = "Tool and object, or the layers of the object, rub with a force that does not depend on speed."
    equation = "F = f s, ds/dx = (tanh(v/transition) - s) sign(v)/presliding while pressed, s = 0 at touch"
    source = (
        "P. R. Dahl, A Solid Friction Model, Aerospace Corp. TOR-158 (1968); "
        "Andersson et al., Tribology Int. 40 (2007)"
    )
    signature = (
        "force is higher by a constant while moving in than while moving out at the same depth, at any speed"
    )
    signals = ("direction", "past motion")
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("force", "{effort}", 0.0, 1e12, (0.05, 5.0)),)
    inner = (
        Parameter("presliding", "{position}", 1e-07, 0.01, (1e-06, 0.001), log=True),
        Parameter("transition", "{position}/s", 1e-07, 0.1, (1e-05, 0.01), log=True),
    )
    confused_with = {
        "bouc_wen_hysteresis": "reverse half way: the curves of Dahl's friction are exponentials",
        "damping": "probe at two speeds: friction does not grow with speed",
        "hysteresis": "press a spring alone: the sensor keeps its hysteresis there",
        "adhesion": "retract slowly beyond the surface",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        s = np.tanh(data.velocity / inner["transition"])
        if inner["presliding"] > self.inner[0].lower:
            touch = number_stretches(data.engaged, data.run)
            s = direction(smooth_jitter(data.position, data.time_s, data.run), touch, inner["presliding"], s)
        return np.where(data.engaged, s, 0.0)[:, None]

    def forms(self) -> tuple["DryFriction", ...]:
        """See `Effect.forms`: of layers within the object, which can only push, or at the tool's sides."""
        return self, _AtTheSides()

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: a path up to a tenth of the depth, or a small share of the usual speed."""
        depth = max(float(np.max(data.position, initial=0.0)), 1e-9)
        speed = float(np.sqrt(np.mean(data.velocity[data.engaged] ** 2))) if data.engaged.any() else 1.0
        paths = [(part, 1e-3) for part in np.geomspace(1e-3, 1e-1, 5)]
        speeds = [(0.0, part) for part in (0.003, 0.01, 0.03, 0.1)]
        return tuple(
            {
                "presliding": max(float(path * depth), self.inner[0].lower),
                "transition": float(share * speed) or 1e-7,
            }
            for path, share in (*paths, *speeds)
        )


class _AtTheSides(DryFriction):
    one_sided = False
    form = 1
