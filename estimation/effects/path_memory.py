"""Dry friction and backlash that depend on the past path."""

from typing import ClassVar

import numpy as np

from palpate.estimation.channel import JOINTS, ChannelData, ChannelKind
from palpate.estimation.effect import (
    AdditiveEffect,
    Errors,
    Inner,
    MotionEffect,
    Parameter,
    Parameters,
    start_grid,
)
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.blocks import number_stretches
from palpate.estimation.signals.cache_by_array import cache_by_channel_arrays
from palpate.estimation.signals.runwise import (
    bouc_wen,
    derivative,
    direction,
    play,
    shifted_motion,
    smooth_jitter,
)
from palpate.robot_io.types import FloatArray, IntArray

_PLAIN = 1e-3  # least relative squared difference from Coulomb friction, else the path is too short


class PreslidingFriction(AdditiveEffect):
    name = "presliding_friction"
    kind = Kind.FRICTION
    physics = "Asperities and cables stretch like springs before they slide, and stay stretched at rest."
    equation = "effort = f s, ds/dq = (1 - s sign(v))/presliding, s = 0 at first"
    source = "P. R. Dahl, A Solid Friction Model, Aerospace Corp. TOR-158 (1968)"
    signature = (
        "after a reversal, effort changes gradually over a distance, at any speed; at rest, it keeps its "
        "value"
    )
    signals: ClassVar[tuple[str, ...]] = ("direction", "past motion")
    channels = JOINTS
    gains: ClassVar[tuple[Parameter, ...]] = (Parameter("force", "{effort}", 0.0, 1e12, (0.001, 50.0)),)
    inner = (Parameter("presliding", "{position}", 1e-9, 10.0, (1e-4, 0.1), log=True),)
    start_multiples = {"presliding": ("range_of_motion", np.geomspace(1e-3, 0.3, 9))}
    path = "presliding"
    confused_with = {
        "coulomb_friction": "stop and creep back and forth: presliding depends on the path, not on the speed",
        "load_dependent_presliding": "repeat with another load",
        "bouc_wen_hysteresis": "reverse halfway: dry friction then approaches its limit exponentially",
        "backlash": "reverse slowly: in a gap, the effort vanishes until the gap is crossed",
        "hysteresis": "reverse slowly at several loads",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        way = smooth_jitter(data.position, data.time_s, data.run)
        return direction(way, data.run, inner["presliding"])[:, None]

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: with too short a path, the effect is Coulomb friction."""
        (path,) = self.inner
        built, plain = (
            self.columns(data, {path.name: length})
            for length in (parameters[f"{self.name}.{path.name}"], PreslidingFriction.inner[0].lower)
        )
        return float(np.sum((built - plain) ** 2)) < _PLAIN * float(np.sum(built**2))


class LoadDependentPresliding(PreslidingFriction):
    name = "load_dependent_presliding"
    physics = "Cables on pulleys and loaded teeth rub in proportion to the load, and stay stretched at rest."
    equation = "effort = mu |load| s, ds/dq = (1 - s sign(v))/presliding"
    source = (
        "P. R. Dahl, Aerospace Corp. TOR-158 (1968); L. Euler, Mém. Acad. Berlin 18 (1762): capstan; "
        "M. Kaneko et al., IEEE ICRA (1991): tendon drives"
    )
    signature = "the jump at reversal grows with the load, extends over a distance, and persists at rest"
    signals = ("direction", "past motion", "load")
    gains = (Parameter("mu", "1", 0.0, 2.0, (0.01, 0.5)),)
    needs = ("load",)
    confused_with = {
        "load_dependent_friction": "stop under load: presliding friction keeps its last value at rest",
        "presliding_friction": "repeat with another load",
        "torque_gain": "lift and lower the same load: only friction changes sign with the motion",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return super().columns(data, inner) * np.abs(data.context["load"])[:, None]


@cache_by_channel_arrays("position", "run", "touching")
def _touches(data: ChannelData) -> IntArray:
    """Number the contacts of a channel and the gaps between them, or the runs of a joint, shape (n,)."""
    return number_stretches(data.engaged, data.run)


class DryFriction(AdditiveEffect):
    """Dry friction whose state s tends to the direction of motion over a short path.

    At speeds below `transition`, a film between the surfaces yields, and s tends to less than the sign of the
    motion. At the lower bound of the path, only the film is left: s = tanh(v/transition), zero at rest.
    """

    name = "dry_friction"
    kind = Kind.FRICTION
    physics = "Tool and object, or the layers of the object, rub with a force that does not depend on speed."
    equation = "F = f s, ds/dx = (tanh(v/transition) - s) sign(v)/presliding while pressed, s = 0 at touch"
    source = "P. R. Dahl, Aerospace Corp. TOR-158 (1968); Andersson et al., Tribology Int. 40 (2007)"
    signature = "at one depth, force is higher by a constant on the way in than on the way out, at any speed"
    signals = ("direction", "past motion")
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("force", "{effort}", 0.0, 1e12, (0.05, 5.0)),)
    inner = (
        Parameter("presliding", "{position}", 1e-09, 10.0, (1e-06, 0.001), log=True),
        Parameter("transition", "{position}/s", 1e-09, 1000.0, (1e-05, 0.01), log=True),
    )
    confused_with = {
        "bouc_wen_hysteresis": "reverse halfway: dry friction then approaches its limit exponentially",
        "damping": "probe at two speeds: friction does not grow with speed",
        "hysteresis": "press a plain spring instead of the object: only the sensor's hysteresis remains",
        "adhesion": "retract slowly beyond the surface",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        if inner["presliding"] > self.inner[0].lower:
            way = smooth_jitter(data.position, data.time_s, data.run)
            # The channel's velocity is smoothed too strongly and shows small reversals late or not at all.
            velocity = derivative(way, data.time_s, data.run)
            s = direction(way, _touches(data), inner["presliding"], np.tanh(velocity / inner["transition"]))
        else:
            s = np.tanh(data.velocity / inner["transition"])
        return np.where(data.engaged, s, 0.0)[:, None]

    def forms(self) -> tuple["DryFriction", ...]:
        return DryFriction(), _AtTheSides()

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: paths up to a tenth of the depth, or transitions relative to the rms speed."""
        speed = float(np.sqrt(np.mean(data.velocity[data.engaged] ** 2))) if data.engaged.any() else 1.0
        paths = [(part, 1e-3) for part in np.geomspace(1e-3, 1e-1, 5)]
        speeds = [(0.0, part) for part in (0.003, 0.01, 0.03, 0.1)]
        return tuple(
            {
                "presliding": max(float(path * data.deepest), self.inner[0].lower),
                "transition": float(share * speed) or 1e-9,
            }
            for path, share in (*paths, *speeds)
        )


class _AtTheSides(DryFriction):
    one_sided = False
    form = 1


class BoucWenHysteresis(AdditiveEffect):
    """Bouc-Wen hysteresis; in a contact it acts only for x > 0, and each contact begins without strain.

    With sharpness 1 and unloading 1 it is Dahl's law. With a high sharpness it is an elastic, perfectly
    plastic spring. See `bouc_wen` for the normalized state w in [-1, 1].
    """

    name = "bouc_wen_hysteresis"
    kind = Kind.FRICTION
    physics = "Internal friction of rubber, wire ropes or structures acts as a spring that yields."
    equation = "effort = f w, dw/dx = (1 - |w|^n)/path while it grows, (1 + unloading |w|^n)/path on return"
    source = "Y.-K. Wen, J. Eng. Mech. ASCE 102 (1976); Ikhouane, Rodellar, Systems with Hysteresis (2007)"
    signature = "effort over position forms loops of equal height at any speed; small loops lie in large ones"
    signals = ("direction", "past motion")
    gains = (Parameter("force", "{effort}", 0.0, 1e12, (0.001, 50.0)),)
    inner = (
        Parameter("path", "{position}", 1e-9, 10.0, (1e-4, 0.1), log=True),
        Parameter("sharpness", "1", 0.5, 20.0, (1.0, 5.0), log=True),
        Parameter("unloading", "1", 0.0, 1.0, (0.0, 1.0)),
    )
    path = "path"
    confused_with = {
        "presliding_friction": "reverse halfway: dry friction then approaches its limit exponentially",
        "dry_friction": "reverse halfway: dry friction then approaches its limit exponentially",
        "hysteresis": "reverse slowly at several loads: a sensor's hysteresis spans a fixed effort",
        "stress_relaxation": "hold: hysteresis stops with the motion, but relaxation continues",
        "damping": "probe at two speeds: hysteresis does not depend on speed",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        way = smooth_jitter(data.position, data.time_s, data.run)
        states = bouc_wen(way, _touches(data), inner["path"], inner["sharpness"], inner["unloading"])
        return np.where(data.engaged, states, 0.0)[:, None]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        paths = np.geomspace(0.01, 0.5, 5) * data.range_of_motion
        return start_grid(
            path=np.maximum(paths, self.inner[0].lower), sharpness=(1.0, 3.0), unloading=(0.0, 1.0)
        )


class Backlash(MotionEffect):
    """The load follows the encoder only after the gap is crossed: q_true = play(q, gap/2).

    The motor keeps turning within the gap: its shares of inertia and viscous friction follow the encoder.
    """

    name = "backlash"
    kind = Kind.FRICTION
    physics = "Teeth, couplings and keys have a gap that must be crossed at each reversal."
    equation = "q_true = play(q, gap/2); it rests inside the gap; inertia and friction of the motor follow q"
    source = "M. Nordin, P.-O. Gutman, Controlling mechanical systems with backlash, Automatica 38 (2002)"
    signature = (
        "just after a reversal the load's share of the effort is missing until the gap is crossed; the rest "
        "position depends on the last direction of motion"
    )
    signals = ("direction", "past motion")
    channels = JOINTS
    inner = (
        Parameter("gap", "{position}", 1e-07, 10.0, (0.0001, 0.1), log=True),
        Parameter("motor_inertia", "1", 0.0, 1.0, (0.0, 1.0)),
        Parameter("motor_friction", "1", 0.0, 1.0, (0.0, 1.0)),
    )
    confused_with = {
        "presliding_friction": "reverse slowly: friction changes sign, but in a gap the effort vanishes",
        "loaded_backlash": "reverse while the load pulls one way: only plain backlash crosses the gap",
        "hysteresis": "reverse slowly at several loads: only a gap spans a fixed distance",
        "coulomb_friction": "reverse slowly",
        "joint_elasticity": (
            "push against a stop: a spring yields in proportion to the push, but a gap by a fixed amount"
        ),
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
        span = data.range_of_motion
        return tuple(
            {"gap": float(part * span), "motor_inertia": 0.5 * motor, "motor_friction": motor}
            for part in np.geomspace(1e-3, 0.35, 10)
            for motor in (0.0, 1.0)
        )

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: half the gap is within one step of the encoder, which acts like play."""
        return parameters[f"{self.name}.gap"] < 2.0 * data.position_step


class LoadedBacklash(MotionEffect):
    """q_true = q - gap/2 s; s, from -1 to 1, is the side of the gap to which the load moved the link.

    Friction holds the link in place at small loads: s is a play operator on the load, limited to [-1, 1].
    At a reversal of the load, s changes from -1 to 1 while the load rises from 0.5 to 1.5 times
    `threshold`. A load of constant sign keeps the link on one flank, so that the gap has no
    effect. The motion of the link across the gap is not modeled.
    """

    name = "loaded_backlash"
    kind = Kind.FRICTION
    physics = "Within the play of a gear, the load pulls the link to one side or the other."
    equation = "q_true = q - gap/2 s, s = clip(2 play(load, threshold)/threshold, -1, 1)"
    source = "M. Nordin, P.-O. Gutman, Automatica 38 (2002), sec. 2: backlash under load"
    signature = "the rest position depends on the last direction of the load, not on the motion"
    signals = ("load",)
    channels = JOINTS
    inner = (
        Parameter("gap", "{position}", 1e-9, 10.0, (1e-4, 0.1), log=True),
        Parameter("threshold", "{effort}", 1e-12, 1e6, (1e-3, 1.0), log=True),
    )
    needs = ("load",)
    confused_with = {
        "backlash": "reverse while the load pulls one way: only plain backlash crosses the gap",
        "joint_elasticity": (
            "increase the load: a spring yields in proportion to it, but a gap by a fixed amount"
        ),
        "presliding_friction": "hold still and change the load",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        threshold = inner["threshold"]
        held = play(data.context["load"], data.run, threshold)
        side = np.clip(2.0 * held / threshold, -1.0, 1.0)
        still = np.zeros(len(data))
        return shifted_motion(data, position=-0.5 * inner["gap"] * side, velocity=still, acceleration=still)

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: shares of the range of motion and of the largest load.

        The smallest threshold stands for a gear without friction.
        """
        most = float(np.max(np.abs(data.context["load"]))) or 1.0
        gap = np.geomspace(1e-3, 2.0, 10) * data.range_of_motion
        return start_grid(gap=gap, threshold=np.array((1e-4, 0.01, 0.1, 0.3)) * most)
