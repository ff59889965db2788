"""Simulates a mass on a spring from its force alone, to compare with figures of the literature."""

from collections.abc import Mapping

import numpy as np
from scipy.signal import resample

_FINER = 8


def free_run(force: np.ndarray, step_s: float, parameters: Mapping[str, float]) -> np.ndarray:
    """Position of m a + c v + k x + k3 x^3 = force from rest: leapfrog on finer steps of the force."""
    m, c = parameters["inertia.m"], parameters["damping.c"]
    k, k3 = parameters["stiffness.k"], parameters.get("cubic_stiffness.k3", 0.0)
    fine = resample(np.concatenate([force, force[::-1]]), 2 * len(force) * _FINER)[: len(force) * _FINER]
    dt, x, v, out = step_s / _FINER, 0.0, 0.0, np.empty(len(force))
    for i, push in enumerate(fine.tolist()):
        if i % _FINER == 0:
            out[i // _FINER] = x
        # half a step of velocity before and after: the damping of the second half is implicit
        half = v + 0.5 * dt * (push - c * v - k * x - k3 * x**3) / m
        x += dt * half
        v = (half + 0.5 * dt * (push - k * x - k3 * x**3) / m) / (1.0 + 0.5 * dt * c / m)
    return out
