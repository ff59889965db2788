"""Faults of a force or torque sensor."""

import numpy as np

from .motion import Array
from .world import CaseWorld, HiddenEffect, by_name, play


def bias(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A wrong zero."""
    b = float(np.sign(u[0] - 0.5)) * s * w.scale
    return HiddenEffect(senses=lambda f: f + b, truth={"offset": b})


def drift(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A zero that drifts at a constant rate from the start."""
    span = w.motion.t[-1] - w.motion.t[0]
    rate = float(np.sign(u[0] - 0.5)) * 2 * s * w.scale / span
    return HiddenEffect(senses=lambda f: f + rate * (w.motion.t - w.motion.t[0]), truth={"rate": rate})


def lag(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A first-order low-pass."""
    tau = 0.2 * s
    return HiddenEffect(senses=lambda f: w.filtered(f, tau), truth={"tau": tau})


def delay(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """All readings are delayed."""
    late = 0.1 * s
    return HiddenEffect(senses=lambda f: w.later(f, late), truth={"time": late})


def saturation(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Readings are limited."""
    limit = (1 - 0.8 * s) * float(np.abs(w.plain).max())
    return HiddenEffect(senses=lambda f: np.clip(f, -limit, limit), truth={"limit": limit})


def deadband(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Small efforts read as zero, and larger ones are reduced by half the width of the band."""
    width = 0.5 * s * w.scale
    return HiddenEffect(
        senses=lambda f: np.sign(f) * np.maximum(np.abs(f) - width, 0.0), truth={"width": width}
    )


def hysteresis(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """The reading follows the effort with play, as in an elastic body with internal friction."""
    width = s * w.scale
    return HiddenEffect(
        senses=lambda f: w.by_run(lambda rows: play(f[rows], width)), truth={"width": 0.5 * width}
    )


def quantisation(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """A converter with few levels. It comes last, after the noise: see `cases.read`."""
    step = s * w.scale
    return HiddenEffect(senses=lambda f: np.round(f / step) * step, truth={"step": step})


SENSOR = by_name(bias, drift, lag, delay, saturation, deadband, hysteresis, quantisation)
AFTER_NOISE = frozenset({"saturation", "quantisation"})


def crosstalk(w: CaseWorld, s: float, u: Array) -> HiddenEffect:
    """Interference with the period of another machine, which no vocabulary has."""
    f = 3 + 9 * u[0]
    return HiddenEffect(
        senses=lambda force: force + s * w.scale * np.sin(2 * np.pi * (f * w.motion.t + u[1]))
    )
