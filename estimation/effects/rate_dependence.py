"""Rate dependence: viscous forces of contacts and joints."""

import numpy as np

from palpate.estimation.channel import JOINTS, ChannelData, ChannelKind
from palpate.estimation.effect import AdditiveEffect, Errors, Inner, Parameter, Parameters
from palpate.estimation.kinds import Kind
from palpate.robot_io.types import FloatArray


class Damping(AdditiveEffect):
    name = "damping"
    kind = Kind.RATE_DEPENDENCE
    physics = "A dashpot resists in proportion to speed."
    equation = "F = c v"
    source = "the viscous half of the Kelvin-Voigt body; W. Flügge, Viscoelasticity (1975), ch. 1"
    signature = (
        "at the same depth, effort is higher on the way in than on the way out; the difference grows with "
        "speed"
    )
    signals = ("velocity",)
    gains = (Parameter("c", "{effort} s/{position}", 0.0, 1e12, (0.1, 500.0)),)
    confused_with = {
        "delay": (
            "probe at two speeds and hold: a delay shifts the force in time, but a damper has no force at "
            "rest"
        ),
        "viscous_friction": "not possible, because both names denote the same term in a joint",
        "stress_relaxation": "hold: relaxation continues at rest, but damping does not",
        "hysteresis": "probe at two speeds: hysteresis does not depend on speed",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.where(data.engaged, data.velocity, 0.0)[:, None]


class ViscousFriction(AdditiveEffect):
    name = "viscous_friction"
    kind = Kind.RATE_DEPENDENCE
    physics = "Oil and bearings resist in proportion to speed."
    equation = "effort = d v"
    source = "B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994)"
    signature = "effort is higher in proportion to speed, in either direction"
    signals = ("velocity",)
    channels = JOINTS
    gains = (Parameter("d", "{effort} s/{position}", 0.0, 1e12, (0.001, 500.0)),)
    confused_with = {
        "joint_coupling": "hold this joint still and move its neighbor",
        "delay": "move at two speeds with the same acceleration",
        "lag": "move at two speeds with the same acceleration",
        "damping": "not possible, because both names denote the same term in a contact",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.velocity[:, None]


class QuadraticDamping(AdditiveEffect):
    name = "quadratic_damping"
    kind = Kind.RATE_DEPENDENCE
    physics = "Displaced fluid resists with the square of speed."
    equation = "F = c2 v |v|"
    source = "L. Prandtl, O. Tietjens, Applied Hydro- and Aeromechanics (1934): drag at high Reynolds number"
    signature = "the difference between loading and unloading grows faster than the speed"
    signals = ("velocity",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("c2", "{effort} s^2/{position}^2", 0.0, 1e12, (1.0, 10000.0)),)
    confused_with = {
        "damping": "probe at three speeds: twice the speed gives four times the force",
        "dry_friction": "probe at three speeds: friction does not depend on speed",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.where(data.engaged, data.velocity * np.abs(data.velocity), 0.0)[:, None]


class QuadraticFriction(AdditiveEffect):
    name = "quadratic_friction"
    kind = Kind.RATE_DEPENDENCE
    physics = "Air, oil churning and motor fans resist with the square of speed."
    equation = "effort = d2 v |v|"
    source = "L. Prandtl, O. Tietjens, Applied Hydro- and Aeromechanics (1934): drag at high Reynolds number"
    signature = "effort rises faster than the speed"
    signals = ("velocity",)
    channels = JOINTS
    gains = (Parameter("d2", "{effort} s^2/{position}^2", 0.0, 1e12, (0.0001, 50.0)),)
    confused_with = {
        "viscous_friction": "move at three speeds",
        "stribeck_friction": "move very slowly and very fast",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return (data.velocity * np.abs(data.velocity))[:, None]


class HuntCrossley(AdditiveEffect):
    name = "hunt_crossley"
    kind = Kind.RATE_DEPENDENCE
    also = frozenset({Kind.ELASTIC_SHAPE})
    physics = "The contact area grows with depth, and stiffness and damping grow with the area."
    equation = "F = k x^n + b x^n v"
    source = "K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975): restitution as damping in vibroimpact"
    signature = "effort curves upwards with depth, and loading and unloading differ more at larger depth"
    signals = ("position", "velocity")
    channels = frozenset({ChannelKind.CONTACT})
    gains = (  # both terms vanish at the surface, so that the force does not jump there
        Parameter("k", "{effort}/{position}^n", 0.0, 1e12, (10.0, 1e6)),
        Parameter("b", "{effort} s/{position}^(n+1)", 0.0, 1e12, (1.0, 1e6)),
    )
    elastic = ("k",)
    essential = ("b",)
    inner = (Parameter("n", "1", 0.5, 4.0, (1.0, 2.0)),)
    confused_with = {
        "power_law_stiffness": "press at two speeds: the damping of hunt_crossley grows with depth",
        "cubic_stiffness": "move further: a power law and a cubic diverge",
        "layered_stiffness": "move further: layers have a kink, but a power law has none",
        "contact_offset": "find the surface by a slow touch: an offset bends the curve near the surface only",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        power = np.maximum(data.position, 0.0) ** inner["n"]
        return np.column_stack([power, power * data.velocity])

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: the exponent is visible in the damper only, not in the spring."""
        k, b, n = (parameters[f"{self.name}.{p.name}"] for p in (*self.gains, *self.inner))
        depth = np.maximum(data.position, 0.0)
        bends = []  # rms of spring and damper terms without their parts in proportion to the depth
        for factor in (np.ones(len(data)), data.velocity):
            power, straight = depth**n * factor, depth * factor
            share = float(power @ straight) / max(float(straight @ straight), 1e-300)
            bends.append(float(np.sqrt(np.mean((power - share * straight) ** 2))))
        return bool(abs(b) * bends[1] > noise > abs(k) * bends[0])
