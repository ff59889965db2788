"""Effects of joints beyond inertia, gravity and viscous friction, and laws outside any vocabulary.

Sources: Armstrong-Helouvry, Dupont and Canudas de Wit 1994 (friction); Dahl 1968; Nordin and Gutman 2002
(play); Spong 1987 (elastic joints).
"""

import numpy as np

from .contact_effects import sawtooth, thinned, warming
from .motion import Array
from .sensor_effects import SENSOR, crosstalk
from .world import CaseWorld, Effect, HiddenEffect, by_name, play

# As in the model of the arm; otherwise the fourth digit of g would decide about a light payload.
GRAVITY = 9.81


def _sign(w: CaseWorld) -> Array:
    return np.tanh(w.motion.v / (0.003 * w.speed))


def coulomb_friction(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """F sign(v)."""
    f = s * w.scale
    return HiddenEffect(adds=f * _sign(w), truth={"force": f})


def stribeck_friction(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """The full Stribeck curve: Coulomb friction that rises at low speed."""
    f, more, vs = s * w.scale, s * w.scale * (0.5 + u[0]), w.speed * (0.05 + 0.15 * u[1])
    return HiddenEffect(
        adds=(f + more * np.exp(-((w.motion.v / vs) ** 2))) * _sign(w),
        truth={"coulomb": f, "rise": more, "speed": vs},
    )


def asymmetric_friction(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Coulomb friction that differs between forward and backward motion."""
    f, b = s * w.scale, s * w.scale * (0.1 + 0.5 * u[0])
    sign = _sign(w)
    return HiddenEffect(adds=np.where(sign > 0, f, b) * sign, truth={"forward": f, "backward": b})


def load_dependent_friction(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Mu |load| sign(v)."""
    mu = s
    return HiddenEffect(adds=mu * np.abs(w.load) * _sign(w), truth={"mu": mu})


def quadratic_friction(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """d2 v |v|."""
    d2 = 2 * s * w.scale / w.speed**2
    return HiddenEffect(adds=d2 * w.motion.v * np.abs(w.motion.v), truth={"d2": d2})


def viscous_friction(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """D v, if the simple model has none."""
    d = s * w.scale / w.speed
    return HiddenEffect(adds=d * w.motion.v, truth={"d": d})


def payload(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A point mass at the tip, at `w.law["tip"]` from the axis."""
    tip = w.law["tip"]
    mass = 2 * s * w.law["g"] / (GRAVITY * tip)
    adds = mass * tip**2 * w.motion.a + mass * GRAVITY * tip * np.sin(w.motion.x)
    return HiddenEffect(adds=adds, truth={"mass": mass})


def armature(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A rotor behind the gear."""
    inertia = 3 * s * w.law["J"]
    return HiddenEffect(adds=inertia * w.motion.a, truth={"inertia": inertia})


def gravity_tilt(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """The base is tilted: gravity acts in another direction."""
    angle = float(np.sign(u[0] - 0.5)) * 0.5 * s
    g, x = w.law["g"], w.motion.x
    tilt = angle if w.base == "rigid_body" else g * np.sin(angle)
    return HiddenEffect(adds=g * (np.sin(x + angle) - np.sin(x)), truth={"tilt": tilt})


def torque_ripple(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A sin(N q + phase)."""
    n, size, phase = int(6 + 30 * u[0]), s * w.scale, 2 * np.pi * u[1]
    truth = {"sine": size * np.cos(phase), "cosine": size * np.sin(phase), "cycles": n}
    return HiddenEffect(adds=size * np.sin(n * w.motion.x + phase), truth=truth)


def ripple_with_harmonics(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Cogging: a ripple with N, 2 N and (weakly) 3 N periods per turn."""
    n, x, size = int(6 + 14 * u[0]), w.motion.x, s * w.scale
    parts = ((1.0, 1, u[1]), (0.6, 2, u[2]), (0.3, 3, u[3]))
    adds = sum(a * np.sin(h * n * x + 2 * np.pi * phase) for a, h, phase in parts)
    return HiddenEffect(adds=size * adds, truth={"cycles": n})


def joint_spring(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """K (q - q0)."""
    k, rest = 2 * s * w.scale / w.size, w.size * (u[0] - 0.3)
    return HiddenEffect(adds=k * (w.motion.x - rest), truth={"k": k, "preload": -k * rest})


def backlash(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """The motor angle is read; the link follows it with play and does not move by itself.

    While the gap is crossed, the motor turns alone and has half of the inertia.
    """
    m, gap = w.motion, 0.5 * s * w.size
    link = w.by_run(lambda rows: play(m.x[rows], gap))
    carried = np.abs(w.rate(link)) > 0
    adds = w.law["g"] * (np.sin(link) - np.sin(m.x)) - 0.5 * w.law["J"] * m.a * ~carried
    return HiddenEffect(adds=w.filtered(adds, 0.002), truth={"gap": gap})


def joint_elasticity(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """The motor angle is read; the link lags behind it by torque over stiffness.

    Singular perturbation to first order: the link follows the given motion, and the motor is ahead of it.
    With the motor held, the link would oscillate at 8 Hz or more.
    """
    give = s / (w.law["J"] * (2 * np.pi * 8.0) ** 2)
    return HiddenEffect(moves=lambda torque: w.load * give, truth={"compliance": give})


def torque_gain(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """The reading is the torque times a gain."""
    gain = float(np.sign(u[0] - 0.5)) * 0.6 * s
    return HiddenEffect(senses=lambda f: (1 + gain) * f, truth={"gain": 1 + gain})


def presliding_friction(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Dahl friction: asperities bend over a distance before they slip."""
    f, over, m = s * w.scale, w.size * (0.02 + 0.1 * u[0]), w.motion

    def element(rows: slice) -> Array:
        dx = np.diff(m.x[rows], prepend=m.x[rows][0]).tolist()
        z, out = 0.0, []
        for step in dx:
            edge = 1.0 if step > 0 else -1.0
            z = edge + (z - edge) * float(np.exp(-abs(step) / over))
            out.append(z)
        return np.array(out)

    return HiddenEffect(adds=f * w.by_run(element), truth={"force": f})


# where each is best hidden: the simple model must not absorb it
IN_RIGID_BODY = by_name(payload, armature, torque_gain, viscous_friction, gravity_tilt)
JOINT: dict[str, Effect] = {
    **by_name(
        *(coulomb_friction, stribeck_friction, asymmetric_friction, load_dependent_friction),
        *(quadratic_friction, torque_ripple, joint_spring, backlash, joint_elasticity, presliding_friction),
    ),
    **IN_RIGID_BODY,
    "torque_ripple (harmonics)": ripple_with_harmonics,
    **{name: SENSOR[name] for name in ("bias", "lag", "delay", "drift", "hysteresis", "quantisation")},
}
NEEDS_GRAVITY = frozenset(
    {"load_dependent_friction", "gravity_tilt", "payload", "backlash", "joint_elasticity"}
)


def _farthest(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A seal that has yielded as far as the joint has ever turned."""
    far = np.maximum.accumulate(np.abs(w.motion.x))
    return HiddenEffect(adds=s * w.scale * np.exp(-(far - np.abs(w.motion.x)) / (0.08 * w.size)) * _sign(w))


def _end_cushion(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Oil that is squeezed out near an end stop: (q - q0)^2 v beyond q0."""
    deep = np.maximum(w.motion.x / w.size - 0.3 - 0.3 * u[0], 0.0)
    return HiddenEffect(adds=10 * s * w.scale * deep**2 * w.motion.v / w.speed)


def _dwell(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Friction that grows with the time at low speed, and vanishes after a short motion."""
    slow = w.filtered((np.abs(w.motion.v) < 0.1 * w.speed).astype(float), 0.3 + u[0])
    return HiddenEffect(adds=3 * s * w.scale * slow * w.motion.v / w.speed)


JOINT_OUTSIDE: dict[str, Effect] = {
    # a sawtooth over the path
    "stick-slip chatter": lambda w, s, u: HiddenEffect(
        adds=s * w.scale * sawtooth(w, w.size * (0.05 + 0.1 * u[0])) * _sign(w)
    ),
    # a bearing that is tight at two angles
    "cos^2 of the angle times speed": lambda w, s, u: HiddenEffect(
        adds=3 * s * w.scale * np.cos(2 * w.motion.x + u[0]) ** 2 * w.motion.v / w.speed
    ),
    # a magnet at one angle
    "magnetic detent": lambda w, s, u: HiddenEffect(
        adds=s * w.scale * np.exp(-(((w.motion.x / w.size - u[0] * 0.6) / (0.06 + 0.1 * u[1])) ** 2))
    ),
    "grease that thins with use": lambda w, s, u: HiddenEffect(
        adds=4 * s * w.scale * thinned(w, 1.0, u[0]) * w.motion.v / w.speed
    ),
    # a torque constant that falls with temperature
    "gain that follows dissipated energy": lambda w, s, u: warming(w, -0.8 * s, u[0]),
    "cross-talk of a periodic signal": crosstalk,
    "seal worn to the largest angle": _farthest,
    "end cushion": _end_cushion,
    "friction that grows at rest": _dwell,
}
