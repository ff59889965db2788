"""What a force or torque sensor does to an effort; `size` grows the fault, `scale` is the effort's RMS."""

from collections.abc import Callable

import numpy as np
from synthetic.motion import RATE_HZ, Motion


def bias(effort: np.ndarray, motion: Motion, size: float, scale: float, shape: float) -> np.ndarray:
    """A constant."""
    return effort + size * scale * (1.0 if shape > 0.5 else -1.0)


def drift(effort: np.ndarray, motion: Motion, size: float, scale: float, shape: float) -> np.ndarray:
    """Straight over the session."""
    return effort + size * scale * (motion.time_s / motion.time_s[-1])


def lag(effort: np.ndarray, motion: Motion, size: float, scale: float, shape: float) -> np.ndarray:
    """First order; what comes in goes straight from sample to sample, and its middle counts for a step."""
    rate = 1.0 / (RATE_HZ * size * 0.1)
    out = np.empty_like(effort)
    for rows in motion.parts():
        state, values = effort[rows][0], effort[rows]
        middles = 0.5 * (values + np.concatenate([values[:1], values[:-1]]))
        for i, middle in enumerate(middles):
            state += (1.0 - np.exp(-rate)) * (middle - state)
            out[rows.start + i] = state
    return out


def delay(effort: np.ndarray, motion: Motion, size: float, scale: float, shape: float) -> np.ndarray:
    """Dead time."""
    out = np.empty_like(effort)
    for rows in motion.parts():
        t = motion.time_s[rows]
        out[rows] = np.interp(t - size * 0.1, t, effort[rows])
    return out


def saturation(effort: np.ndarray, motion: Motion, size: float, scale: float, shape: float) -> np.ndarray:
    """Cut at a share of the largest effort."""
    limit = np.max(np.abs(effort)) * (1.0 - min(size, 0.95))
    return np.minimum(np.maximum(effort, -limit), limit)


def deadband(effort: np.ndarray, motion: Motion, size: float, scale: float, shape: float) -> np.ndarray:
    """Nothing shown below a threshold, and that much less above."""
    return np.sign(effort) * np.maximum(np.abs(effort) - size * scale, 0.0)


def hysteresis(effort: np.ndarray, motion: Motion, size: float, scale: float, shape: float) -> np.ndarray:
    """A friction element between effort and reading."""
    out = np.empty_like(effort)
    for rows in motion.parts():
        reading = effort[rows][0]
        for i, value in enumerate(effort[rows]):
            reading = min(max(reading, value - size * scale), value + size * scale)
            out[rows.start + i] = reading
    return out


def quantisation(effort: np.ndarray, motion: Motion, size: float, scale: float, shape: float) -> np.ndarray:
    """Whole steps."""
    step = size
    return np.floor(effort / step + 0.5) * step


FAULTS: dict[str, Callable[[np.ndarray, Motion, float, float, float], np.ndarray]] = {
    f.__name__: f for f in (bias, drift, lag, delay, saturation, deadband, hysteresis, quantisation)
}
