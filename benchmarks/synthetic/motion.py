"""Motions of a probing arm and of a swinging joint, with what encoders make of them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import savgol_filter

RATE_HZ = 1000.0


@dataclass(frozen=True)
class Motion:
    """True motion of all runs, one after another."""

    time_s: np.ndarray  # over the whole session [s]
    x: np.ndarray  # position [m] or [rad]
    v: np.ndarray  # velocity
    a: np.ndarray  # acceleration
    run: np.ndarray  # run of each sample

    def parts(self) -> list[slice]:
        """The rows of each run."""
        borders = [0, *(np.flatnonzero(np.diff(self.run)) + 1), len(self.run)]
        return [slice(start, stop) for start, stop in pairwise(borders)]


def assemble(paths: list[np.ndarray], pause_s: float = 2.0) -> Motion:
    """One session out of each run's path at `RATE_HZ`, less its ends, where derivatives are one-sided."""
    dt, times, xs, vs, accs, runs, start = 1.0 / RATE_HZ, [], [], [], [], [], 0.0
    for number, path in enumerate(paths):
        v = np.gradient(path, dt)
        a = np.gradient(v, dt)[5:-5]
        times.append(start + dt * np.arange(len(a)))
        xs.append(path[5:-5])
        vs.append(v[5:-5])
        accs.append(a)
        runs.append(np.full(len(a), number))
        start = times[-1][-1] + pause_s
    return Motion(*(np.concatenate(parts) for parts in (times, xs, vs, accs, runs)))


def presses(rng: np.random.Generator, depth_m: float, repeats: int = 2) -> Motion:
    """Presses at three speeds: free air, in, hold (creeping and shaken a little), out, free air."""
    dt, paths = 1.0 / RATE_HZ, []
    for speed in (0.15, 0.09, 0.06) * repeats:
        deepest = depth_m * rng.uniform(0.75, 1.15)
        gap, hold_s = rng.uniform(0.008, 0.012), rng.uniform(0.9, 1.3)
        steps = [(0.2, 0.0), ((gap + deepest) / speed, speed), (hold_s, 0.0)]
        steps += [((gap + deepest) / speed * 1.3, -speed / 1.3), (0.3, 0.0)]
        velocity = np.concatenate([np.full(round(t / dt), v) for t, v in steps])
        path = gaussian_filter1d(np.cumsum(velocity) * dt - gap, 12.0, mode="nearest")
        held = np.convolve(path > 0.97 * deepest, np.ones(80) / 80.0, mode="same")
        t = dt * np.arange(len(path))
        shaking = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (2.3, 5.1, 9.7))
        path = path + 0.01 * deepest * held * shaking + 0.01 * deepest * held * np.cumsum(held) * dt
        paths.append(gaussian_filter1d(path, 4.0, mode="nearest"))
    return assemble(paths)


def swings(rng: np.random.Generator, runs: int = 6, run_s: float = 10.0, size: float = 1.0) -> Motion:
    """Swings of several frequencies, other in each run."""
    paths = []
    for _ in range(runs):
        t = np.arange(round(run_s * RATE_HZ)) / RATE_HZ
        path = rng.uniform(-0.3, 0.3) * size * np.ones_like(t)
        for f in rng.uniform([0.08, 0.25, 0.6, 1.2], [0.2, 0.5, 1.1, 2.2]):
            amplitude = rng.uniform(0.5, 1.0) * 0.6 * size / (1.0 + (f / 0.6) ** 1.5)
            path = path + amplitude * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28))
        paths.append(path)
    return assemble(paths)


def measured(motion: Motion, rng: np.random.Generator, noise: float, step: float) -> Motion:
    """The motion that an encoder with noise and steps shows, differentiated without phase error."""
    dt = 1.0 / RATE_HZ
    x = np.round((motion.x + rng.normal(0.0, noise, len(motion.x))) / step) * step
    v, a = np.empty_like(x), np.empty_like(x)
    for rows in motion.parts():
        v[rows] = savgol_filter(x[rows], 25, 3, deriv=1, delta=dt)
        a[rows] = savgol_filter(x[rows], 41, 3, deriv=2, delta=dt)
    return Motion(motion.time_s, x, v, a, motion.run)
