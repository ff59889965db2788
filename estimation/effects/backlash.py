"""Play between motor and load."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, MotionEffect, Parameter
from estimation.kinds import Kind
from estimation.signals.runwise import play
from estimation.signals.shifted_motion import shifted_motion


class Backlash(MotionEffect):
    """The load follows the encoder only after the gap is crossed: q_true = play(q, gap/2).

    The motor turns on: its shares of inertia and viscous friction are moved as the encoder says.
    """

    name = "backlash"
    kind = Kind.FRICTION
    physics = "Teeth, couplings and keys have a gap that must be crossed at each reversal."
    equation = "q_true = play(q, gap/2); it rests inside the gap, the motor's inertia and friction do not"
    source = "M. Nordin, P.-O. Gutman, Controlling mechanical systems with backlash, Automatica 38 (2002)"
    signature = (
        "just after a reversal the load's share of the effort is missing until the gap is crossed; "
        "the resting place depends on the last direction"
    )
    signals = ("direction", "past motion")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    inner = (
        Parameter("gap", "{position}", 1e-07, 10.0, (0.0001, 0.1), log=True),
        Parameter("motor_inertia", "1", 0.0, 1.0, (0.0, 1.0)),
        Parameter("motor_friction", "1", 0.0, 1.0, (0.0, 1.0)),
    )
    confused_with = {
        "presliding_friction": "reverse slowly: friction changes sign, through a gap effort is nothing",
        "loaded_backlash": "reverse the motion with the load to one side: the link then stays on its flank",
        "hysteresis": "reverse slowly at several loads: a gap is crossed in position, a hysteresis in effort",
        "coulomb_friction": "reverse slowly",
        "joint_elasticity": "press against a stop: a spring yields in proportion, a gap by a fixed amount",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        followed = play(data.position, data.run, 0.5 * inner["gap"])
        behind = data.position - followed
        pushed = (np.abs(behind) > 0.498 * inner["gap"]) & (behind * data.velocity > 0.0)
        return shifted_motion(
            data,
            position=-behind,
            velocity=np.where(pushed, 0.0, (inner["motor_friction"] - 1.0) * data.velocity),
            acceleration=np.where(pushed, 0.0, (inner["motor_inertia"] - 1.0) * data.acceleration),
        )

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a thousandth to a third of the range; with and without a motor."""
        span = float(np.ptp(data.position)) or 1.0
        return tuple(
            {"gap": float(part * span), "motor_inertia": 0.5 * motor, "motor_friction": motor}
            for part in np.geomspace(1e-3, 0.35, 10)
            for motor in (0.0, 1.0)
        )
