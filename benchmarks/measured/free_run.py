"""Simulates a mass on a spring from its force alone, to compare with figures of the literature."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import resample

_FINER = 8
_SETTLED = 300  # samples after which a start from rest is forgotten
_AT_THE_END = 20  # samples that feel the end of the resampled force
SHIFT = "shift"  # of the force against the position, in samples


def free_run(force: np.ndarray, step_s: float, parameters: Mapping[str, float]) -> np.ndarray:
    """Position of m a + c v + k x + k3 x^3 = force from rest: leapfrog on finer steps of the force."""
    m, c = parameters["inertia.m"], parameters["damping.c"]
    k, k3 = parameters["stiffness.k"], parameters.get("cubic_stiffness.k3", 0.0)
    force = _later(force, parameters.get(SHIFT, 0.0))
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


def refined(
    runs: Sequence[tuple[np.ndarray, np.ndarray]], step_s: float, parameters: Mapping[str, float]
) -> dict[str, float]:
    """Parameters that reproduce positions best in a free run, from those that explain the forces best.

    Noise in a derived acceleration and a small shift between the converters count little in the force, but
    much in a free run near resonance. The shift is fitted as well.

    Args:
        runs: force and position of each.
        step_s: sample time [s].
        parameters: to start from.
    """
    names, start = list(parameters), np.array(list(parameters.values()))

    def parameters_at(scaled: np.ndarray) -> dict[str, float]:
        return {**dict(zip(names, start * scaled[:-1], strict=True)), SHIFT: float(scaled[-1] - 1.0)}

    def missed(scaled: np.ndarray) -> np.ndarray:
        simulated = ((free_run(force, step_s, parameters_at(scaled)), x) for force, x in runs)
        return np.concatenate([(run - x)[_SETTLED:-_AT_THE_END] for run, x in simulated])

    found = least_squares(missed, np.ones(len(names) + 1), diff_step=1e-4, max_nfev=10, x_scale=1e-2)
    return parameters_at(found.x)


def _later(signal: np.ndarray, samples: float) -> np.ndarray:
    phase = np.exp(-2j * np.pi * np.fft.rfftfreq(len(signal)) * samples)
    return np.fft.irfft(np.fft.rfft(signal) * phase, len(signal))
