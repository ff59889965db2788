"""Presses onto an object, made from formulas, for the tests of the diagnosis."""

from copy import deepcopy
from functools import cache, partial

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from palpate.estimation.channel import ChannelData, ChannelKind

K, C, NOISE_N = 800.0, 15.0, 0.05
RATE_HZ = 500.0


def motion(rng, runs=6, depth_m=0.012):
    """Time, depth, speed and run: in at different speeds, held while shaken a little, out again."""
    paths = []
    for number in range(runs):
        speed = (0.1, 0.06, 0.03)[number % 3]
        deepest, dt = depth_m * rng.uniform(0.8, 1.1), 1.0 / RATE_HZ
        travel = (deepest + 0.004) / speed
        steps = ((0.15, 0.0), (travel, speed), (0.6, 0.0), (travel, -speed), (0.15, 0.0))
        v = np.concatenate([np.full(round(t / dt), s) for t, s in steps])
        path = np.cumsum(v) * dt - 0.004
        path += (
            1e-4 * np.sin(2 * np.pi * 6.0 * dt * np.arange(len(path)) + rng.uniform(0, 6)) * (path > 0.006)
        )
        paths.append(gaussian_filter1d(path, 8.0, mode="nearest"))
    x = np.concatenate(paths)
    run = np.repeat(np.arange(runs), [len(p) for p in paths])
    v = np.concatenate([np.gradient(p, 1.0 / RATE_HZ) for p in paths])
    time_s = np.concatenate([3.0 * i + np.arange(len(p)) / RATE_HZ for i, p in enumerate(paths)])
    return time_s, x, v, run


def frozen(*arrays):
    """Make arrays read-only, so that palpate caches results that depend only on them."""
    for array in arrays:
        array.setflags(write=False)
    return arrays


@cache
def _seeded_motion(seed, runs):
    """The motion of a session, its acceleration, and the generator's state after it."""
    rng = np.random.default_rng(seed)
    time_s, x, v, run = motion(rng, runs)
    return frozen(time_s, x, v, run, np.gradient(v, 1.0 / RATE_HZ)), rng


def kelvin_voigt(x, v, extra=0.0):
    """Force of a spring, a damper and something more; an object can only push."""
    return np.where(x > 0, np.maximum(K * x + C * v + extra, 0.0), 0.0)


def colored_noise(rng, count, correlation):
    noise = rng.normal(0.0, NOISE_N * np.sqrt(1 - correlation**2), count)
    return lfilter([1.0], [1.0, -correlation], noise)


def channel(force, time_s, x, v, run, a=None):
    a = np.gradient(v, 1.0 / RATE_HZ) if a is None else a
    return ChannelData("contact", ChannelKind.CONTACT, time_s, x, v, a, force, run, np.full(len(x), -1))


def session(seed, law=lambda t, x, v, run: kelvin_voigt(x, v), correlation=0.0, runs=3):
    """A session whose force is `law(time, depth, speed, run)` with autocorrelated noise."""
    (time_s, x, v, run, a), rng = _seeded_motion(seed, runs)
    force = law(time_s, x, v, run) + colored_noise(deepcopy(rng), len(x), correlation)
    return channel(force, time_s, x, v, run, a)


long_session = partial(session, runs=6)  # where what is tested goes by the number of runs


def maxwell(time_s, x, run, tau_s):
    """A spring in series with a dashpot, stepped: z' = x' - z / tau."""
    kept = 1.0 / (1.0 + 1.0 / (RATE_HZ * tau_s))
    pressed = np.maximum(x, 0.0)
    steps = np.diff(pressed, prepend=pressed[:1])
    return np.concatenate([lfilter([kept], [1.0, -kept], steps[run == number]) for number in np.unique(run)])
