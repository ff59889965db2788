"""Elastic shape: springs in parallel with the object, and springs in series with it."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from palpate.estimation.channel import JOINTS, ChannelData, ChannelKind
from palpate.estimation.data.derivatives import Motion, differentiate, wider_window
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
from palpate.estimation.signals.motion import never_returns
from palpate.estimation.signals.runwise import shifted_motion
from palpate.robot_io.types import FloatArray

_STRAIGHT = 0.1  # distance of the exponent from 1 within which the law is practically linear
_CLEARLY = 2.0  # standard errors by which a slope must exceed zero
_SHOWN = 0.03  # share of the upper layer's force that must exceed the sensor's dead band
_OTHER_SPRINGS = {"hunt_crossley.k", "stress_relaxation.k1"}
_FEWEST_BENT = 5  # least number of samples of all runs with 0 < x < d, which show the bend
_STEEPEST = 50.0  # limit of b |x|, to avoid overflow
_STARTS = (0.5, 1.0, 2.0, 4.0, 7.0, 12.0)  # b times the largest |x|


class Stiffness(AdditiveEffect):
    name = "stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "A spring pushes back in proportion to how far it is displaced."
    equation = "F = k x"
    source = "R. Hooke, De Potentia Restitutiva (1678); the elastic half of the Kelvin-Voigt body"
    signature = "effort grows in proportion to displacement, at any speed, equally on the way in and out"
    signals = ("position",)
    gains = (Parameter("k", "{effort}/{position}", 0.0, 1e12, (10.0, 2e4)),)
    elastic = ("k",)
    confused_with = {
        "cubic_stiffness": "move to several positions: a linear spring has the same slope everywhere",
        "contact_offset": "press to several depths from a known surface",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.where(data.engaged, data.position, 0.0)[:, None]


class CubicStiffness(AdditiveEffect):
    name = "cubic_stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "The spring becomes stiffer (or softer) with displacement."
    equation = "F = k3 x^3"
    source = "G. Duffing, Erzwungene Schwingungen bei veränderlicher Eigenfrequenz (1918)"
    signature = (
        "the slope of effort over position grows with displacement, equally on both sides, at any speed"
    )
    signals = ("position",)
    gains = (Parameter("k3", "{effort}/{position}^3", -1e13, 1e13, (1.0, 1e9)),)
    elastic = ("k3",)
    confused_with = {
        "exponential_stiffness": "move further: an exponential soon exceeds a cubic",
        "power_law_stiffness": "move further: a power law and a cubic diverge",
        "hunt_crossley": "move further: a power law and a cubic diverge",
        "layered_stiffness": "move further: a layer has a kink where the slope jumps, but a cubic has none",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        depth = np.where(data.engaged, data.position, 0.0)[:, None]
        return depth * depth * depth  # ten times faster than a power


class PowerLawStiffness(AdditiveEffect):
    name = "power_law_stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "With depth, more (or less) of the object carries the load, so the force curve bends."
    equation = "F = k |x|^n sign(x)"
    source = "H. Hertz, J. reine angew. Math. 92 (1882): n = 3/2; I. N. Sneddon, Int. J. Eng. Sci. 3 (1965)"
    signature = "effort over position is a straight line on logarithmic axes, at any speed"
    signals = ("position",)
    gains = (Parameter("k", "{effort}/{position}^n", 0.0, 1e40, (10.0, 1e12)),)
    elastic = ("k",)
    # 1.5 for the contact of a sphere (Hertz), 2 for that of a cone (Sneddon); below 1 the spring softens.
    inner = (Parameter("n", "1", 0.3, 6.0, (0.4, 4.0)),)
    confused_with = {
        "cubic_stiffness": "move further: a power law and a cubic diverge",
        "exponential_stiffness": "move further: an exponential soon exceeds any power law",
        "hunt_crossley": "press at two speeds: the damping of hunt_crossley grows with depth",
        "layered_stiffness": "move further: layers have a kink, but a power law has none",
        "softening_stiffness": (
            "move further: a power law keeps softening, but the force of softening_stiffness becomes linear"
        ),
        "contact_offset": "find the surface by a slow touch: an offset bends the curve near the surface only",
    }

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: with an exponent near 1 it is a linear spring."""
        return abs(parameters[f"{self.name}.n"] - 1.0) < _STRAIGHT

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        pressed = np.where(data.engaged, data.position, 0.0)
        return (np.sign(pressed) * np.abs(pressed) ** inner["n"])[:, None]


class LayeredStiffness(AdditiveEffect):
    name = "layered_stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "Below a certain depth a stiffer or softer layer carries load too, or the specimen yields."
    equation = "F = k2 max(x - d, 0)"
    source = "S. Timoshenko, Vibration Problems in Engineering (1937), ch. II: piecewise-linear stiffness"
    signature = (
        "the slope of force over depth jumps at one depth; if a layer causes the jump, it also appears on "
        "the way out"
    )
    signals = ("position",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("k2", "{effort}/{position}", -1e12, 1e12, (10.0, 20000.0)),)
    elastic = ("k2",)
    inner = (Parameter("depth", "{position}", 0.0, 10.0, (0.001, 0.02)),)
    start_multiples = {"depth": ("deepest", np.linspace(0.1, 0.85, 11))}
    confused_with = {
        "exponential_stiffness": "move further: beyond the kink a layer is linear",
        "softening_stiffness": "record more samples near the bend: only a layer has a kink",
        "cubic_stiffness": "move further: beyond the kink a layer is linear, but a cubic keeps curving",
        "hunt_crossley": "move further: beyond the kink a layer is linear, but a power law keeps curving",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.maximum(data.position - inner["depth"], 0.0)[:, None]

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: the data do not show that both layers push.

        Without the upper layer it is a gap or a dead band. Without the lower one it is a saturated sensor, or
        a specimen that yields, which is likelier if the motion never returns. The upper layer is also
        invisible if the sensor's dead band hides nearly all of its force: the object then seems to begin at
        the kink, like a deeper surface. The check applies only if linear and cubic springs are the only other
        elastic effects.
        """
        if "stiffness.k" not in parameters or _OTHER_SPRINGS & parameters.keys():
            return False
        k, k2, kink = (parameters[name] for name in ("stiffness.k", f"{self.name}.k2", f"{self.name}.depth"))
        k3, deepest = parameters.get("cubic_stiffness.k3", 0.0), float(np.max(data.position))
        upper = k * kink + k3 * kink**3
        lower = (k + k2) * (deepest - kink) + k3 * (deepest**3 - kink**3)
        visible = upper - parameters.get("deadband.width", 0.0)
        may_yield = never_returns(data.position, data.run)
        if visible < max(noise, _SHOWN * upper) or (lower < noise and not may_yield):
            return True
        if k3 != 0.0:
            return False  # with a cubic term, no single slope describes a layer
        known = errors()
        is_stiff = may_yield or _has_positive_slope(k + k2, known[f"{self.name}.k2"])
        return not (is_stiff and _has_positive_slope(k, known["stiffness.k"]))


def _has_positive_slope(slope: float, std_err: float) -> bool:
    """Return whether a layer's slope is clearly positive; if its error is unknown, only the sign counts."""
    return slope >= (0.0 if np.isnan(std_err) else _CLEARLY * std_err)


class SofteningStiffness(AdditiveEffect):
    name = "softening_stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "The object yields gradually, or its fibers slip one after the other, so stiffness falls."
    equation = "F = a (1 - exp(-x/d))"
    source = "E. Voce, J. Inst. Metals 74 (1948): strain hardening that approaches a limit"
    signature = "the slope of force over depth falls exponentially towards a constant"
    signals = ("position",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("a", "{effort}", 0.0, 1e12, (0.01, 1000.0)),)
    elastic = ("a",)
    inner = (Parameter("d", "{position}", 1e-12, 10.0, (1e-4, 0.02), log=True),)
    start_multiples = {"d": ("deepest", (0.03, 0.07, 0.15, 0.3, 0.6, 1.2))}
    confused_with = {
        "layered_stiffness": "record more samples near the bend: only a layer has a kink",
        "power_law_stiffness": "move further: a power law keeps softening, but this force becomes linear",
        "plastic_set": "unload: an elastic spring softens in the same way on the way out",
        "contact_offset": "find the surface by a slow touch: a wrong surface bends only the curve's start",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return -np.expm1(-np.maximum(data.position, 0.0) / inner["d"])[:, None]

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: few samples show the bend, so that the law looks like a jump."""
        near = (data.position > 0.0) & (data.position < parameters[f"{self.name}.d"])
        return bool(np.count_nonzero(near) < _FEWEST_BENT)


class JointSpring(AdditiveEffect):
    name = "joint_spring"
    kind = Kind.ELASTIC_SHAPE
    physics = "A balancing spring, or a cable that bends with the joint, pulls the joint to one position."
    equation = "effort = k q + p, at rest where q = -p/k"
    source = "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots (2002), ch. 9"
    signature = "effort grows in proportion to position, whatever the speed"
    signals = ("position",)
    channels = JOINTS
    gains = (
        Parameter("k", "{effort}/{position}", -1e12, 1e12, (0.01, 1000.0)),
        Parameter("preload", "{effort}", -1e12, 1e12, (-10.0, 10.0)),
    )
    essential = ("k",)
    confused_with = {
        "bias": "move over a wide range: a bias is the same everywhere",
        "gravity_tilt": "fit all joints together (a tilt affects all of them), or move over a wide range",
        "cubic_stiffness": "move over a wide range",
        "stiffness": "not possible, because both names denote the same term in a contact",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.column_stack([data.position, np.ones(len(data))])

    def describe_physics(self, parameters: Mapping[str, float]) -> str:
        """See `Effect.describe_physics`: a spring of negative stiffness is active, or is not a spring."""
        if parameters["k"] >= 0.0:
            return self.physics
        return (
            "The stiffness is negative, so this is not a passive spring. There are three common causes: a "
            "raised weight, which pushes a joint away from one position; an effort or a position with the "
            "opposite sign; or the command of a position controller, Kp (setpoint - q), recorded as the "
            "effort."
        )


class JointElasticity(MotionEffect):
    name = "joint_elasticity"
    kind = Kind.ELASTIC_SHAPE
    physics = "Gears, shafts and belts twist under the load, so that the link lags the measured motor."
    equation = "q_true = q - c load, with its derivatives"
    source = "M. W. Spong, J. Dyn. Sys. Meas. Control 109 (1987)"
    signature = (
        "errors appear at fast changes of the load, because they grow with the second derivative of the load"
    )
    signals = ("load",)
    channels = JOINTS
    inner = (Parameter("compliance", "{position}/{effort}", 0.0, 1e9, (1e-05, 0.1), log=True),)
    needs = ("load",)
    confused_with = {
        "lag": "move slowly under a large load: a spring still yields, but a lag has no effect",
        "inertia": (
            "move at two frequencies: the effect of elasticity grows with the fourth power of the frequency"
        ),
    }

    def __init__(self, form: int = 0) -> None:
        """Create the effect with wider differentiation windows.

        Args:
            form: number of steps in `HALF_WINDOWS` by which the windows are wider.
        """
        self.form = form

    def forms(self) -> tuple["JointElasticity", ...]:
        """See `Effect.forms`: several window widths, since the noise of the load's derivatives is unknown."""
        return tuple(JointElasticity(wider) for wider in _CHANGES)

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        c, load = inner["compliance"], data.context["load"]
        changes = _CHANGES[self.form](data)
        return shifted_motion(
            data, position=-c * load, velocity=-c * changes.velocity, acceleration=-c * changes.acceleration
        )

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        load = float(np.std(data.context["load"])) or 1.0
        span = float(np.std(data.position)) or 1.0
        return start_grid(compliance=np.geomspace(3e-4, 0.3, 10) * span / load)


def _changes(data: ChannelData, wider: int) -> Motion:
    """Differentiate the load twice, with windows that are `wider` steps wider than usual."""
    # Narrow windows would follow smooth errors of the load. The usual windows are selected only once.
    usual = _CHANGES[0](data).half_windows if wider else None
    halves = usual and (wider_window(usual[0], wider), wider_window(usual[1], wider))
    return differentiate(data.time_s, data.context["load"], data.run, halves, rounding=0.0)


_CHANGES = {
    wider: cache_by_channel_arrays("time_s", "run", "load")(partial(_changes, wider=wider))
    for wider in (0, 2, 4, 6)
}


class ToolCompliance(MotionEffect):
    name = "tool_compliance"
    kind = Kind.ELASTIC_SHAPE
    also = frozenset({Kind.TIME_MEMORY})  # a spring in series with a damper relaxes
    physics = "Tool, sensor and links bend, so the true depth is less than the encoders report."
    equation = "x_true = x - c F, v_true = v - c dF/dt"
    source = "two springs in series; A. Albu-Schäffer et al., Int. J. Robotics Research 26 (2007)"
    signature = "the object seems softer the harder it is pressed, and less damped than it is"
    signals = ("position", "effort")
    channels = frozenset({ChannelKind.CONTACT})
    inner = (Parameter("compliance", "{position}/{effort}", 0.0, 1e9, (1e-06, 0.001), log=True),)
    confused_with = {
        "cubic_stiffness": "press a rigid block: only the tool yields",
        "damping": "press a rigid block: only the tool yields",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        force = _smooth_force(data)
        return replace(
            data,
            position=data.position - inner["compliance"] * force.position,
            velocity=data.velocity - inner["compliance"] * force.velocity,
        )

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        yielding = float(np.ptp(data.position) / (np.ptp(data.effort) or 1.0))
        return start_grid(compliance=np.geomspace(1e-3, 1.0, 7) * yielding)


@cache_by_channel_arrays("time_s", "run", "effort", "position", "touching")
def _smooth_force(data: ChannelData) -> Motion:
    """Return the smoothed force and its rate; the noise of the force determines the window."""
    return differentiate(
        data.time_s, data.effort, number_stretches(data.engaged, data.run), rounding=0.0, prefer_wide=False
    )


class ExponentialStiffness(AdditiveEffect):
    """The nonlinear part of Fung's law for fibrous tissue; its linear part a b x belongs to `stiffness`."""

    name = "exponential_stiffness"
    kind = Kind.ELASTIC_SHAPE
    physics = "Fibers straighten one after the other, so stiffness grows with the force."
    equation = "F = a (exp(b |x|) - 1 - b |x|) sign(x)"
    source = "Y. C. Fung, Am. J. Physiology 213 (1967): elasticity of soft tissues in simple elongation"
    signature = "the slope of effort over position is a linear function of the effort, at any speed"
    signals = ("position",)
    gains = (Parameter("a", "{effort}", 0.0, 1e12, (1e-4, 10.0)),)
    elastic = ("a",)
    inner = (Parameter("b", "1/{position}", 1e-3, 1e9, (10.0, 1000.0), log=True),)
    confused_with = {
        "power_law_stiffness": "move further: an exponential soon exceeds any power law",
        "cubic_stiffness": "move further: an exponential soon exceeds a cubic",
        "layered_stiffness": "move further: layers have a kink, but an exponential has none",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        pressed = np.where(data.engaged, data.position, 0.0)
        steep = np.minimum(inner["b"] * np.abs(pressed), _STEEPEST)
        return np.asarray(np.sign(pressed) * (np.expm1(steep) - steep))[:, None]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        deepest = float(np.max(np.abs(data.position), initial=0.0)) or 1.0
        return start_grid(b=np.clip(np.array(_STARTS) / deepest, 1e-3, 1e9))
