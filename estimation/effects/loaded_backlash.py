"""Play in which the load decides on which side the link leans."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, MotionEffect, Parameter
from estimation.kinds import Kind
from estimation.signals.runwise import play
from estimation.signals.shifted_motion import shifted_motion


class LoadedBacklash(MotionEffect):
    """q_true = q - gap/2 s; s goes to 1 as the load exceeds `threshold`, to -1 below -threshold.

    Between the two friction holds the link where it is: s is the load's play operator, cut off at the flanks,
    and goes over between half and one and a half times the threshold. A load that always pulls one way keeps
    the link on one flank, and nothing of the gap is seen. The link's own motion across is not modelled.
    """

    name = "loaded_backlash"
    kind = Kind.FRICTION
    physics = "Within the play of a gear the load pulls the link to one flank or to the other."
    equation = "q_true = q - gap/2 s, s = clip(2 play(load, threshold)/threshold, -1, 1)"
    source = "M. Nordin, P.-O. Gutman, Automatica 38 (2002), sec. 2: backlash under load"
    signature = "the resting place depends on which way the load pulled last, and not on the motion"
    signals = ("load",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    inner = (
        Parameter("gap", "{position}", 1e-9, 10.0, (1e-4, 0.1), log=True),
        Parameter("threshold", "{effort}", 1e-12, 1e6, (1e-3, 1.0), log=True),
    )
    needs = ("load",)
    confused_with = {
        "backlash": "reverse the motion with the load to one side: the link then stays on its flank",
        "joint_elasticity": "load it more: a spring yields in proportion, a gap by a fixed amount",
        "presliding_friction": "hold still and change the load",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        threshold = inner["threshold"]
        held = play(data.context["load"], data.run, threshold)
        side = np.clip(2.0 * held / threshold, -1.0, 1.0)
        still = np.zeros(len(data))
        return shifted_motion(data, position=-0.5 * inner["gap"] * side, velocity=still, acceleration=still)

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: shares of the range of motion and of the largest load."""
        span = float(np.ptp(data.position)) or 1.0
        most = float(np.max(np.abs(data.context["load"]))) or 1.0
        return tuple(
            {"gap": float(part * span), "threshold": share * most}
            for part in np.geomspace(1e-3, 2.0, 10)
            for share in (0.003, 0.03, 0.1, 0.3)
        )
