"""Effects of objects beyond a spring and a damper, and laws outside any vocabulary.

Sources: Hunt and Crossley 1975; Fung 1981 (quasi-linear viscoelasticity); Johnson, Contact Mechanics 1985
(adhesion, elastic-plastic unloading); Mullins 1969.
"""

import numpy as np
from scipy.integrate import cumulative_trapezoid

from .motion import FINE_HZ, Array
from .sensor_effects import SENSOR, crosstalk
from .world import CaseWorld, Effect, HiddenEffect, by_name


def sawtooth(w: CaseWorld, period: float) -> Array:
    """Return a sawtooth over the path, from -1 to 1."""
    path = cumulative_trapezoid(np.abs(w.motion.v), dx=1 / FINE_HZ, initial=0.0)
    return 2 * ((path / period) % 1.0) - 1


def thinned(w: CaseWorld, used: Array | float, chance: float) -> Array:
    """Return the share of a viscosity that use has left; only motion while `used` is 1 counts."""
    path = cumulative_trapezoid(np.abs(w.motion.v) * used, dx=1 / FINE_HZ, initial=0.0)
    return np.exp(-path / (path[-1] * (0.08 + 0.2 * chance)))


def warming(w: CaseWorld, gain: float, chance: float) -> HiddenEffect:
    """Return a gain that follows the dissipated heat, which decays."""
    heat = w.filtered(np.abs(w.plain * w.motion.v), 1.0 + 4 * chance)
    return HiddenEffect(senses=lambda f: f * (1 + gain * heat / heat.max()))


def cubic_stiffness(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """F += k3 x^3."""
    k3 = 4 * s * w.law["k"] / w.size**2
    return HiddenEffect(adds=k3 * w.pressed**3, one_sided=True, truth={"k3": k3})


def _power(w: CaseWorld, n: float) -> Array:
    return w.law["k"] * w.size * ((w.pressed / w.size) ** n - w.pressed / w.size)


def power_law_stiffness(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """F = k x^n in place of k x."""
    n = 1 + 1.5 * s
    return HiddenEffect(adds=_power(w, n), one_sided=True, truth={"n": n, "stiffness.k": 0.0})


def hunt_crossley(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """F = k x^n + b x^n v in place of k x; the damper c stays."""
    n, m = 1 + s * (0.3 + u[0]), w.motion
    b = 0.6 * s * (0.3 + u[1]) / w.speed
    adds = _power(w, n) + b * w.law["k"] * w.size * (w.pressed / w.size) ** n * m.v
    k = w.law["k"] * w.size ** (1 - n)
    return HiddenEffect(adds=adds, one_sided=True, truth={"k": k, "b": b * k, "n": n, "stiffness.k": 0.0})


def layered_stiffness(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A stiffer layer below a depth."""
    depth, dk = w.size * (0.25 + 0.35 * u[0]), 4 * s * w.law["k"]
    return HiddenEffect(
        adds=dk * np.maximum(w.pressed - depth, 0.0), one_sided=True, truth={"k2": dk, "depth": depth}
    )


def _maxwell(w: CaseWorld, k: float, tau: float) -> Array:
    """Return a spring in series with a dashpot: k times the high-pass filtered depth."""
    return k * (w.pressed - w.filtered(w.pressed, tau))


def stress_relaxation(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """One Maxwell branch beside the spring."""
    k, tau = 2 * s * w.law["k"], 0.1 * 10 ** (1.1 * u[0])
    return HiddenEffect(adds=_maxwell(w, k, tau), one_sided=True, truth={"k1": k, "tau": tau})


def relaxation_spectrum(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Two Maxwell branches, a decade or more apart; a sudden press loads both in addition to the spring."""
    fast, fast_time = 2 * s * w.law["k"], 0.05 * 10 ** (0.5 * u[0])
    slow, slow_time = fast * (0.6 + 0.6 * u[1]), fast_time * (12 + 10 * u[2])
    at_once = w.law["k"] + fast + slow
    truth = {
        "stiffness.k": at_once,
        "fast": fast / at_once,
        "slow": slow / at_once,
        "fast_time": fast_time,
        "slow_time": slow_time,
    }
    adds = _maxwell(w, fast, fast_time) + _maxwell(w, slow, slow_time)
    return HiddenEffect(adds=adds, one_sided=True, truth=truth)


def quadratic_damping(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """F += c2 v |v|."""
    c2, m = 2 * s * w.law["k"] * w.size / w.speed**2, w.motion
    return HiddenEffect(adds=c2 * m.v * np.abs(m.v) * w.touching, one_sided=True, truth={"c2": c2})


def adhesion(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A pull while touching, and a neck that stretches on the way back until it breaks."""
    pull, neck, m = s * w.scale, 0.05 * w.size * (0.3 + u[0]), w.motion
    sticks, out = False, np.zeros(len(m.x))
    begins = set((np.flatnonzero(np.diff(m.run)) + 1).tolist())
    for i, x in enumerate(m.x.tolist()):
        sticks = (sticks and i not in begins and x > -neck) or x > 0.0
        if sticks:
            out[i] = -pull * min(1.0, 1.0 + x / neck)
    return HiddenEffect(adds=out, truth={"force": pull})


def plastic_set(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A share of the largest depth remains as the new zero of the spring."""
    share = 0.6 * s
    lost = np.minimum(share * w.deepest(), w.pressed)
    return HiddenEffect(adds=-w.law["k"] * lost, one_sided=True, truth={"share": share})


def dry_friction(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Dry friction between tool and object."""
    f = s * w.scale
    return HiddenEffect(adds=f * np.tanh(w.motion.v / (0.01 * w.speed)) * w.touching, truth={"force": f})


def contact_offset(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """The surface is not at zero depth."""
    off = float(np.sign(u[0] - 0.5)) * 0.4 * s * w.size
    return HiddenEffect(moves=lambda f: np.full(len(f), off), truth={"offset": off})


def tool_compliance(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """The tool deflects, and its deflection is read as depth.

    k z + c z' = (x - z) / compliance while pressed, z the object's depth.
    """
    compliance, k, c, dt = 2 * s / w.law["k"], w.law["k"], w.law["c"], 1 / FINE_HZ
    z, depth = 0.0, np.zeros(len(w.motion.x))
    for i, x in enumerate(w.motion.x.tolist()):
        z = (c * z / dt + x / compliance) / (c / dt + k + 1 / compliance) if x > 0.0 else x
        depth[i] = z
    force = np.maximum(w.motion.x - depth, 0.0) / compliance
    push = k * w.pressed + c * w.motion.v * w.touching
    return HiddenEffect(adds=force - push, one_sided=True, truth={"compliance": compliance})


CONTACT = (
    by_name(
        *(cubic_stiffness, power_law_stiffness, hunt_crossley, layered_stiffness, stress_relaxation),
        *(relaxation_spectrum, quadratic_damping, adhesion, plastic_set, dry_friction),
        *(contact_offset, tool_compliance),
    )
    | SENSOR
)


def _buckling(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A dome that snaps through at a depth, and back at a smaller one."""
    snap, out, state = w.size * (0.35 + 0.2 * u[0]), np.zeros(len(w.motion.x)), 0.0
    for i, x in enumerate(w.motion.x.tolist()):
        state = 1.0 if x > snap else 0.0 if x < 0.7 * snap else state
        out[i] = state
    return HiddenEffect(adds=-0.8 * s * w.law["k"] * snap * w.filtered(out, 0.01), one_sided=True)


CONTACT_OUTSIDE: dict[str, Effect] = {
    # a sawtooth over the path while touching
    "stick-slip chatter": lambda w, s, u: HiddenEffect(
        adds=s * w.scale * sawtooth(w, w.size * (0.03 + 0.1 * u[0])) * np.sign(w.motion.v) * w.touching
    ),
    # F += b x^2 v
    "x^2 v damping": lambda w, s, u: HiddenEffect(
        adds=3 * s * w.scale * (w.pressed / w.size) ** 2 * w.motion.v / w.speed, one_sided=True
    ),
    # a magnet that pulls at a depth: exp(-((x - x0) / w)^2)
    "magnetic detent": lambda w, s, u: HiddenEffect(
        adds=s * w.scale * np.exp(-(((w.motion.x / w.size - 0.25 - 0.4 * u[0]) / (0.06 + 0.1 * u[1])) ** 2))
    ),
    # thixotropy
    "viscosity that thins with use": lambda w, s, u: HiddenEffect(
        adds=4 * s * w.scale * thinned(w, w.touching, u[0]) * w.motion.v / w.speed * w.touching,
        one_sided=True,
    ),
    "gain that follows dissipated energy": lambda w, s, u: warming(w, 2 * s, u[0]),
    # stiffer during loading than during unloading
    "stiffness by direction of speed": lambda w, s, u: HiddenEffect(
        adds=s * w.load * np.tanh(w.motion.v / (0.05 * w.speed)), one_sided=True
    ),
    "snap-through": _buckling,
    "cross-talk of a periodic signal": crosstalk,
    # softer at depths below the largest one so far (Mullins 1969)
    "Mullins softening": lambda w, s, u: HiddenEffect(
        adds=-0.8 * s * w.load * (1 - np.exp(-(w.deepest() - w.pressed) / (0.1 * w.size))), one_sided=True
    ),
    # force periodic in depth
    "laminate": lambda w, s, u: HiddenEffect(
        adds=s * w.scale * np.sin(2 * np.pi * (w.pressed / (w.size * (0.08 + 0.1 * u[0])))) * w.touching
    ),
}
