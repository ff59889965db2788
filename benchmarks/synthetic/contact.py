"""A soft object under a probe, with effects hidden in it. Stepped at the sampling rate.

`size` grows an effect from nothing; `shape` in [0, 1] sets its second number (depth, time ...).
"""

from collections.abc import Mapping

import numpy as np
from synthetic.motion import RATE_HZ, Motion

OBJECT = (
    *("hunt_crossley", "cubic_stiffness", "layered_stiffness", "stress_relaxation", "quadratic_damping"),
    *("adhesion", "plastic_set", "dry_friction", "contact_offset", "tool_compliance"),
)


def force(
    motion: Motion, k: float, c: float, hidden: Mapping[str, float], shape: Mapping[str, float]
) -> np.ndarray:
    """Force on the probe [N] for each sample; the object cannot pull unless it sticks.

    All presses are on one spot: a part of it that flows has not flowed back when the next one comes soon.
    """
    out = np.empty(len(motion.x))
    stretch, ended_s = 0.0, 0.0
    tau = _flowing_time(shape)
    for rows in motion.parts():
        stretch *= np.exp(-(motion.time_s[rows.start] - ended_s) / tau)
        out[rows], stretch = _one_press(motion.x[rows], motion.v[rows], k, c, hidden, shape, stretch)
        ended_s = motion.time_s[rows.stop - 1]
    return out


def _one_press(
    x: np.ndarray,
    v: np.ndarray,
    k: float,
    c: float,
    hidden: Mapping[str, float],
    shape: Mapping[str, float],
    stretch: float,
) -> tuple[np.ndarray, float]:
    """Force of one press that finds, and leaves behind, a stretch of what flows [m]."""
    dt, depth = 1.0 / RATE_HZ, 10.0 / k
    x = x - 0.2 * depth * hidden.get("contact_offset", 0.0)
    if "plastic_set" in hidden:
        dent = min(hidden["plastic_set"], 0.9) * np.maximum(np.maximum.accumulate(x), 0.0)
        x, v = x - dent, v - np.gradient(dent, dt)
    if "tool_compliance" in hidden:
        x, v = _behind_tool(x, v, k, c, hidden["tool_compliance"] / k)
    pressed = x > 0.0
    d = np.where(pressed, x, 0.0)
    n = 1.0 + hidden.get("hunt_crossley", 0.0)
    if "hunt_crossley" in hidden:
        total = (k * depth + 2.0 * c * v) * (d / depth) ** n
    else:
        total = k * d + c * v * pressed
    total = total + 10.0 * hidden.get("cubic_stiffness", 0.0) * (d / depth) ** 3
    kink = depth * (0.3 + 0.3 * shape.get("layered_stiffness", 0.5))
    total = total + k * hidden.get("layered_stiffness", 0.0) * np.maximum(d - kink, 0.0)
    total = total + 500.0 * hidden.get("quadratic_damping", 0.0) * v * np.abs(v) * pressed
    if "stress_relaxation" in hidden:
        stretched = _dashpot_in_series(d, _flowing_time(shape), dt, stretch)
        total, stretch = total + hidden["stress_relaxation"] * k * stretched, float(stretched[-1])
    if "dry_friction" in hidden:
        total = total + 10.0 * hidden["dry_friction"] * _bristle(x, 0.003 * depth) * pressed
    if "adhesion" in hidden:
        reach = depth * (0.05 + 0.15 * shape.get("adhesion", 0.5))
        stuck = np.maximum.accumulate(pressed) * np.exp(np.minimum(x, 0.0) / reach)
        return np.maximum(np.where(pressed, total, 0.0), 0.0) - 10.0 * hidden["adhesion"] * stuck, stretch
    return np.maximum(np.where(pressed, total, 0.0), 0.0), stretch


def _flowing_time(shape: Mapping[str, float]) -> float:
    """In which a strain of what flows falls to a third [s]."""
    return float(0.08 * 10.0 ** shape.get("stress_relaxation", 0.5))


def _behind_tool(
    x: np.ndarray, v: np.ndarray, k: float, c: float, compliance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Where the tip really is: k z + c z' = (x - z) / compliance while pressed."""
    dt, z, tip = 1.0 / RATE_HZ, x[0], np.empty_like(x)
    for i, target in enumerate(x):
        if target <= 0.0 or compliance <= 0.0:
            z = target
        else:
            z = (c * max(z, 0.0) / dt + target / compliance) / (c / dt + k + 1.0 / compliance)
        tip[i] = z
    return tip, np.gradient(tip, dt)


def _dashpot_in_series(d: np.ndarray, tau: float, dt: float, stretch: float) -> np.ndarray:
    out, before = np.empty_like(d), 0.0
    for i, now in enumerate(d):
        stretch = (stretch + now - before) / (1.0 + dt / tau)
        out[i], before = stretch, now
    return out


def _bristle(x: np.ndarray, length: float) -> np.ndarray:
    """Deflection of bristles between -1 and 1, exactly for the way that was gone: no earlier at any speed."""
    z, out = 0.0, np.empty_like(x)
    for i, way in enumerate(np.diff(x, prepend=x[0])):
        z = np.sign(way) + (z - np.sign(way)) * np.exp(-abs(way) / length)
        out[i] = z
    return out
