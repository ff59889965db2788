"""Dry friction as a function of the present motion."""

from typing import ClassVar

import numpy as np

from palpate.estimation.channel import JOINTS, ChannelData
from palpate.estimation.effect import AdditiveEffect, Errors, Inner, Parameter, Parameters, start_grid
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.motion import never_returns
from palpate.robot_io.types import FloatArray

TRANSITION = Parameter("transition", "{position}/s", 1e-9, 1e3, (1e-4, 0.05), log=True)
# Largest work that a fitted friction supplies to the motion, relative to what it dissipates; errors of the
# fitted waves may cause as much.
_DRIVEN = 0.05


class CoulombFriction(AdditiveEffect):
    name = "coulomb_friction"
    kind = Kind.FRICTION
    physics = "Dry surfaces rub with a constant force against the motion."
    equation = "effort = f tanh(v/transition)"
    source = "C. A. Coulomb, Théorie des machines simples (1785); Andersson et al., Tribology Int. 40 (2007)"
    signature = "effort jumps where the velocity changes sign, by the same amount at any speed and position"
    signals: ClassVar[tuple[str, ...]] = ("direction",)
    channels = JOINTS
    gains: ClassVar[tuple[Parameter, ...]] = (Parameter("force", "{effort}", 0.0, 1e12, (0.001, 50.0)),)
    inner: ClassVar[tuple[Parameter, ...]] = (TRANSITION,)
    start_multiples = {"transition": ("rms_speed", (0.003, 0.01, 0.03, 0.08))}
    confused_with = {
        "bias": "reverse the motion: friction then acts the other way, but a bias does not",
        "position_dependent_friction": "move over a wide range",
        "presliding_friction": (
            "stop and creep back and forth: presliding depends on the path, not on the speed"
        ),
        "stribeck_friction": "move very slowly: Stribeck friction rises towards zero speed",
        "load_dependent_friction": "repeat with another load: Coulomb friction does not change",
        "asymmetric_friction": "let the joint rest: a bias remains, but asymmetric friction vanishes",
        "hysteresis": "reverse slowly at several loads",
        "backlash": "reverse slowly: in a gap, the effort vanishes until the gap is crossed",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.tanh(data.velocity / inner["transition"])[:, None]


class AsymmetricFriction(CoulombFriction):
    name = "asymmetric_friction"
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
        "bias": "let the joint rest: a bias remains, but asymmetric friction vanishes",
        "coulomb_friction": "move equally in both directions",
    }
    parts = ("coulomb_friction", "bias")

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        direction = np.tanh(data.velocity / inner["transition"])
        forward, backward = np.maximum(direction, 0.0), np.minimum(direction, 0.0)  # both are zero at rest
        return np.column_stack([forward, backward, forward * data.velocity, -backward * data.velocity])

    def simpler(self, columns: FloatArray) -> FloatArray:
        """See `Effect.simpler`: symmetric friction and a bias, which differ from this effect only at rest."""
        symmetric = np.column_stack([columns[:, 0] + columns[:, 1], columns[:, 2] + columns[:, 3]])
        return np.column_stack([symmetric, np.ones(len(symmetric))])


_LUMPED = "lumped_inertia_effort"  # signal of a joint whose model lumps the inertias of rotor and link
_SHARES = (1.0, 0.6)


class LoadDependentFriction(CoulombFriction):
    """Friction in proportion to the load, which is the effort of the joint without friction.

    The torque that accelerates the rotor does not pass through the gear, so it is not part of the load (see
    Hamon et al.). If the model has one inertia for rotor and link, the link's share of it is a parameter.
    """

    name = "load_dependent_friction"
    physics = "Gear teeth and bearings rub in proportion to the load they carry."
    equation = "effort = mu |load| tanh(v/transition); for a pendulum, load = weight + link_share J a"
    source = (
        "A. C. Bittencourt, S. Gunnarsson, J. Dyn. Sys. Meas. Control 134 (2012); "
        "P. Hamon, M. Gautier, P. Garrec, IEEE/RSJ IROS (2010)"
    )
    signature = "the jump at reversal is larger where the joint carries more"
    signals = ("direction", "load")
    gains = (Parameter("mu", "1", 0.0, 2.0, (0.01, 0.5)),)
    needs = ("load",)
    confused_with = {
        "load_dependent_presliding": "stop under load: presliding friction keeps its last value at rest",
        "coulomb_friction": "repeat with another load",
        "torque_gain": "lift and lower the same load: only friction changes sign with the motion",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return super().columns(data, inner) * np.abs(self._load(data, inner))[:, None]

    def _load(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.asarray(data.context["load"])

    def suited_to(self, data: ChannelData) -> "LoadDependentFriction":
        return _WithRotor() if _LUMPED in data.context else self


class _WithRotor(LoadDependentFriction):
    inner = (*LoadDependentFriction.inner, Parameter("link_share", "1", 0.0, 1.0, (0.3, 1.0)))

    def _load(self, data: ChannelData, inner: Inner) -> FloatArray:
        lumped = data.context.get(_LUMPED, 0.0)  # absent if the search removed the weight from the model
        return np.asarray(data.context["load"] - (1.0 - inner["link_share"]) * lumped)

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        sliding = super().starts(data)
        return tuple({**start, "link_share": share} for share in _SHARES for start in sliding)


class PositionDependentFriction(AdditiveEffect):
    name = "position_dependent_friction"
    kind = Kind.FRICTION
    physics = "Eccentric gears, bent guides and worn tracks rub more at some places than at others."
    equation = "effort = (level + sine sin(n q) + cosine cos(n q)) tanh(v/transition)"
    source = "B. Armstrong-Hélouvry, Control of Machines with Friction (1991), ch. 5: friction by position"
    signature = "the difference between the two directions of motion varies with position, at any speed"
    signals = ("position", "direction")
    channels = JOINTS
    gains = (
        Parameter("level", "{effort}", 0.0, 1e12, (0.001, 50.0)),
        Parameter("sine", "{effort}", -1e12, 1e12, (0.001, 5.0)),
        Parameter("cosine", "{effort}", -1e12, 1e12, (0.001, 5.0)),
    )
    essential = ("sine", "cosine")
    # With less than a wave in the range of motion, it fits any friction that varies smoothly with position.
    inner = (Parameter("cycles", "1/{position}", 1e-3, 1e5, (0.5, 10.0), log=True), TRANSITION)
    confused_with = {
        "torque_ripple": "compare both directions: ripple keeps its sign, but friction does not",
        "load_dependent_friction": "repeat with another load at the same places",
        "coulomb_friction": "move over a wide range",
    }

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: in one direction, it cannot be told from any law of the position."""
        return super().applies_to(data) and not never_returns(data.position, data.run)

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        sliding = np.tanh(data.velocity / inner["transition"])
        angle = inner["cycles"] * data.position
        return np.column_stack([sliding, sliding * np.sin(angle), sliding * np.cos(angle)])

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: at some positions it drives the motion, which no friction does."""
        gains, inner = (
            {parameter.name: parameters[f"{self.name}.{parameter.name}"] for parameter in group}
            for group in (self.gains, self.inner)
        )
        power = (self.columns(data, inner) @ np.array([*gains.values()])) * data.velocity
        return bool(np.minimum(power, 0.0).sum() < -_DRIVEN * np.maximum(power, 0.0).sum())

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        waves = np.array((0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0))
        cycles = 2.0 * np.pi * waves / data.range_of_motion
        return start_grid(cycles=cycles, transition=np.array((0.01, 0.05)) * data.rms_speed)


# Share of `rise` by which the maximum friction must exceed the Coulomb level. It requires a `speed` of three
# to four times `transition` (twice, if the rise is far larger than the level).
_SEEN = 0.5


class StribeckFriction(AdditiveEffect):
    name = "stribeck_friction"
    kind = Kind.FRICTION
    physics = "At low speed the lubricant film breaks down and friction rises."
    equation = "effort = (fc + rise exp(-(v/vs)^2)) tanh(v/transition)"
    source = (
        "Stribeck, VDI-Zeitschrift 46 (1902); Armstrong-Hélouvry, Control of Machines with Friction (1991)"
    )
    signature = "effort falls with rising speed just after each reversal, then levels off"
    signals = ("velocity", "direction")
    channels = JOINTS
    gains = (
        Parameter("coulomb", "{effort}", 0.0, 1e12, (0.001, 50.0)),
        Parameter("rise", "{effort}", -1e12, 1e12, (0.001, 50.0)),
    )
    essential = ("rise",)
    inner = (Parameter("speed", "{position}/s", 1e-09, 1000.0, (0.001, 1.0), log=True), TRANSITION)
    start_multiples = {
        "speed": ("rms_speed", np.geomspace(0.04, 1.2, 6)),
        "transition": ("rms_speed", (0.003, 0.01, 0.03)),
    }
    confused_with = {
        "coulomb_friction": "move very slowly, and at several speeds",
        "viscous_friction": "move very slowly, and at several speeds",
        "asymmetric_friction": "move equally in both directions",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        sliding = np.tanh(data.velocity / inner["transition"])
        return np.column_stack([sliding, sliding * np.exp(-((data.velocity / inner["speed"]) ** 2))])

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: friction never rises visibly, since the rise lies within the transition.

        The law is then Coulomb friction with a different shape of the transition.
        """
        level, rise, speed, transition = (
            parameters[f"{self.name}.{p.name}"] for p in (*self.gains, *self.inner)
        )
        v = np.linspace(0.0, 3.0 * (speed + transition), 500)
        friction = (level + rise * np.exp(-((v / speed) ** 2))) * np.tanh(v / transition)
        return float(friction.max()) - level < _SEEN * abs(rise)
