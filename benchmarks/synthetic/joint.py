"""A pendulum on a gear, with effects hidden in the joint. Angles hang at zero.

`size` grows an effect from nothing; `shape` in [0, 1] sets its second number (speed, waves ...).
"""

from collections.abc import Mapping

import numpy as np
from synthetic.motion import RATE_HZ, Motion

JOINT = (
    *("coulomb_friction", "stribeck_friction", "asymmetric_friction", "load_dependent_friction"),
    *("quadratic_friction", "gravity_tilt", "torque_ripple", "joint_spring"),
    *("backlash", "joint_elasticity", "cubic_stiffness"),
)
INERTIA, GRAVITY, VISCOUS = 0.05, 2.0, 0.15  # kg m^2, N m, N m s/rad


def torque(motion: Motion, hidden: Mapping[str, float], shape: Mapping[str, float]) -> np.ndarray:
    """Torque that the motor gives [N m] for each sample."""
    out = np.empty(len(motion.x))
    for rows in motion.parts():
        out[rows] = _one_run(motion.x[rows], motion.v[rows], motion.a[rows], hidden, shape)
    return out


def _one_run(
    q: np.ndarray, v: np.ndarray, a: np.ndarray, hidden: Mapping[str, float], shape: Mapping[str, float]
) -> np.ndarray:
    if "backlash" in hidden:
        q, v, a = _through_gap(q, v, a, 0.2 * hidden["backlash"])
    tilt = hidden.get("gravity_tilt", 0.0)  # part of what the gear carries
    load = INERTIA * a + _weight(q, tilt)
    if "joint_elasticity" in hidden:
        load = _wound_up(q, v, 20.0 / hidden["joint_elasticity"], tilt)
    total = load + VISCOUS * v
    turn = np.clip(v / 0.005, -1.0, 1.0)
    total = total + hidden.get("coulomb_friction", 0.0) * turn
    speed = 0.1 + 0.25 * shape.get("stribeck_friction", 0.5)
    total = total + hidden.get("stribeck_friction", 0.0) * turn * (0.6 + np.exp(-((v / speed) ** 2)))
    uneven = np.where(v > 0, 1.0 + 0.3 * v, -0.45 + 0.1 * v) * np.abs(turn)
    total = total + hidden.get("asymmetric_friction", 0.0) * uneven
    total = total + hidden.get("load_dependent_friction", 0.0) * turn * np.abs(load)
    total = total + hidden.get("quadratic_friction", 0.0) * v * np.abs(v)
    waves = 12.0 + np.floor(20.0 * shape.get("torque_ripple", 0.5))
    total = total + hidden.get("torque_ripple", 0.0) * np.sin(waves * q + 1.0)
    total = total + hidden.get("joint_spring", 0.0) * q
    return np.asarray(total + hidden.get("cubic_stiffness", 0.0) * q**3)


def _through_gap(
    q: np.ndarray, v: np.ndarray, a: np.ndarray, gap: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A load that rests where it is until one side of the gap pushes it."""
    link, driven = q[0], np.zeros(len(q), dtype=bool)
    out = np.empty_like(q)
    for i, motor in enumerate(q):
        if motor > link + gap / 2:
            link, driven[i] = motor - gap / 2, True
        elif motor < link - gap / 2:
            link, driven[i] = motor + gap / 2, True
        out[i] = link
    return out, v * driven, a * driven


def _weight(q: np.ndarray, tilt: float) -> np.ndarray:
    return GRAVITY * np.sin(q) + tilt * np.cos(q)


def _wound_up(q: np.ndarray, v: np.ndarray, k: float, tilt: float) -> np.ndarray:
    """Torque in the spring between the motor at q and a link that swings behind it, a little damped."""
    steps, damping = 8, 0.4 * np.sqrt(k * INERTIA)
    dt = 1.0 / RATE_HZ / steps
    link, speed, out = q[0] - _weight(q[0], tilt) / k, v[0], np.empty_like(q)
    for i in range(len(q)):
        for _ in range(steps):
            spring = k * (q[i] - link) + damping * (v[i] - speed)
            speed += dt * (spring - _weight(link, tilt)) / INERTIA
            link += dt * speed
        out[i] = k * (q[i] - link) + damping * (v[i] - speed)
    return out
