"""Motions of different controllers, on a fine grid of time: x(t), dx/dt, d2x/dt2 of each run.

A motion is drawn as a shape between 0 (start) and about 1 (full depth, or full swing), which is then scaled,
smoothed as by a drive, and differentiated. No formula here depends on an effect.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

Array = NDArray[np.float64]
FINE_HZ = 2000.0


@dataclass(frozen=True)
class TrueMotion:
    """All runs, concatenated on the fine grid; time continues between runs."""

    t: Array  # [s], shape (n,)
    x: Array  # depth [m] or angle [rad]
    v: Array  # dx/dt
    a: Array  # d2x/dt2
    run: NDArray[np.int64]  # number of the run of each sample

    def each(self) -> list[slice]:
        """Yield the samples of each run."""
        edges = [0, *(np.flatnonzero(np.diff(self.run)) + 1).tolist(), len(self.run)]
        return [slice(start, stop) for start, stop in pairwise(edges)]


def _time(seconds: float) -> Array:
    return np.arange(int(seconds * FINE_HZ)) / FINE_HZ


def ramps(rng: Generator, speed: float) -> Array:
    """Move in at constant speed, rest, and move out, twice, each with its own height."""
    heights = [0.0, 1.0, 1.0, 0.0, 0.0, rng.uniform(0.4, 0.8), 0.5, -0.1, -0.1]
    at, t = 0.0, [0.0]
    for before, after in pairwise(heights):
        at += 0.15 + max(abs(after - before) / (speed * rng.uniform(0.6, 1.4)), rng.uniform(0.1, 0.6))
        t.append(at)
    return np.interp(_time(at), t, heights)


def s_curves(rng: Generator, speed: float) -> Array:
    """Make minimum-jerk moves between heights (Flash and Hogan 1985)."""
    pieces, here = [np.zeros(int(0.2 * FINE_HZ))], 0.0
    for target in (*rng.permutation([1.0, 0.3, 0.7]), -0.1, rng.uniform(0.6, 0.9), 0.0):
        s = _time(max(1.9 * abs(target - here) / speed, 0.15))
        s = s / s[-1]
        pieces.append(here + (target - here) * (10 * s**3 - 15 * s**4 + 6 * s**5))
        pieces.append(np.full(int(rng.uniform(0.1, 0.7) * FINE_HZ), target))
        here = target
    return np.concatenate(pieces)


def _ridden(rng: Generator, speed: float, ride: Callable[[Array], Array]) -> Array:
    """Move in, follow an oscillation about the middle, and move out."""
    middle = 0.55
    t = _time(rng.uniform(4.0, 8.0))
    into = np.minimum(_time(middle / speed + 0.3) * speed, middle)
    window = np.clip(np.minimum(t, t[-1] - t) / 0.3, 0.0, 1.0)
    return np.concatenate([np.zeros(400), into, middle + 0.4 * window * ride(t), into[::-1], np.zeros(400)])


def chirp(rng: Generator, speed: float) -> Array:
    """Follow a sine with rising frequency."""
    low, high = 0.1 * speed, rng.uniform(0.6, 1.5) * speed
    return _ridden(rng, speed, lambda t: np.sin(2 * np.pi * t * (low + 0.5 * (high - low) * t / t[-1])))


def multisine(rng: Generator, speed: float) -> Array:
    """Follow several sines with random phases."""
    f = rng.uniform(0.15, 1.2, 5) * speed
    phase = rng.uniform(0, 2 * np.pi, 5)

    def ride(t: Array) -> Array:
        total = np.sin(2 * np.pi * np.outer(t, f) + phase) @ (1 / np.sqrt(f))
        return total / np.abs(total).max()

    return _ridden(rng, speed, ride)


def admittance(rng: Generator, speed: float) -> Array:
    """Move in at constant speed, settle to a few levels with first-order lag as in a force hold, move out."""
    levels = [*rng.uniform(0.5, 1.0, 3), -0.1, rng.uniform(0.4, 0.9), 0.0]
    x, here, lag = [np.zeros(400)], 0.0, rng.uniform(0.1, 0.3)
    for level in levels:
        t = _time(max(abs(level - here) / speed, 0.1) + rng.uniform(0.6, 1.2))
        ramp = here + np.sign(level - here) * np.minimum(speed * t, abs(level - here))
        weight = np.exp(-_time(5 * lag) / lag)
        x.append(here + np.convolve(ramp - here, weight / weight.sum())[: len(t)])
        here = x[-1][-1]
    return np.concatenate(x)


def wander(rng: Generator, speed: float) -> Array:
    """Follow a hand that guides the tool: a slow random walk with some tremor."""
    t = _time(rng.uniform(5.0, 9.0))
    walk = gaussian_filter1d(rng.standard_normal(len(t)), FINE_HZ * 0.25 / speed)
    walk = (walk - walk.min()) / np.ptp(walk)
    tremor = gaussian_filter1d(rng.standard_normal(len(t)), FINE_HZ * 0.02)
    return walk * 1.1 - 0.1 + 0.004 * tremor / tremor.std()


SHAPES = (ramps, s_curves, chirp, multisine, admittance, wander)


def draw(
    rng: Generator,
    size: float,
    speed: float,
    runs: int,
    *,
    below: float,
    rounding_s: tuple[float, float],
) -> tuple[TrueMotion, str]:
    """Draw a session of several runs with different depths and speeds.

    Args:
        rng: random generator of the case.
        size: scale of a shape, the value at 1 [m or rad].
        speed: full heights per second in the fastest run [1/s].
        runs: number of runs.
        rounding_s: range of the time over which the drive rounds corners (standard deviation) [s].
        below: position of a shape's 0, in sizes (such as -0.1: in free air).
    """
    shape = SHAPES[rng.integers(len(SHAPES))]
    rounding = rng.uniform(*rounding_s)
    depths = np.geomspace(1.0, rng.uniform(0.45, 0.8), runs)
    speeds = speed * rng.permutation(np.geomspace(1.0, rng.uniform(0.15, 0.4), runs))
    parts, clock = [], 0.0
    for number, (depth, pace) in enumerate(zip(depths, speeds, strict=True)):
        way = below * size + size * (depth - below) * shape(rng, pace)
        x = gaussian_filter1d(way, FINE_HZ * rounding, mode="nearest")
        v = np.gradient(x, 1 / FINE_HZ)
        t = clock + np.arange(len(x)) / FINE_HZ
        parts.append((t, x, v, np.gradient(v, 1 / FINE_HZ), np.full(len(x), number)))
        clock = t[-1] + rng.uniform(1.0, 4.0)
    return TrueMotion(*(np.concatenate(part) for part in zip(*parts, strict=True))), shape.__name__
