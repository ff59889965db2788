"""Swinging joints made from formulas, and their motion read coarsely or noisily."""

from dataclasses import replace
from functools import cache, partial

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.fit.measurement_model import channel_derivative
from tests.estimation.presses import frozen

NOISE_NM, INERTIA, WEIGHT, DAMPING = 0.02, 0.05, 2.0, 0.15


def no_torque(q, v, a):
    return 0.0 * q


@cache
def _motion(seed, runs, seconds, rate_hz):
    """Return time, position, velocity, acceleration and run, read-only, and the noise of the torque."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    w, p = rng.uniform([1.5, 3.0, 6.0], [2.5, 4.5, 9.0], (runs, 3)), rng.uniform(0.0, 6.0, (runs, 3))
    w, waves, size = w[:, :, None], w[:, :, None] * t + p[:, :, None], np.array([0.8, 0.5, 0.2])[:, None]
    q, v = (size * np.sin(waves)).sum(1).ravel(), (size * w * np.cos(waves)).sum(1).ravel()
    a = -(size * w**2 * np.sin(waves)).sum(1).ravel()
    run = np.repeat(np.arange(runs), len(t))
    return frozen(np.tile(t, runs) + 2.0 * seconds * run, q, v, a, run), rng.normal(0.0, NOISE_NM, len(q))


def swings(seed, extra=no_torque, *, sensor=lambda torque, run: torque, runs=3, seconds=3.0, rate_hz=250.0):
    """A pendulum's swings with a hidden torque `extra(q, v, a)`; `sensor(torque, run)` bends its reading."""
    (time_s, q, v, a, run), noise = _motion(seed, runs, seconds, rate_hz)
    torque = sensor(INERTIA * a + WEIGHT * np.sin(q) + DAMPING * v + extra(q, v, a), run) + noise
    return ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, q, v, a, torque, run, np.full(len(q), -1))


def late(torque, run, samples=12):
    """Delay a torque in each run by some samples, and repeat the first value before."""
    parts = (torque[run == number] for number in np.unique(run))
    return np.concatenate([np.concatenate([np.repeat(part[:1], samples), part[:-samples]]) for part in parts])


def link_angles(q, gap, runs=3):
    """Angles of a link that rests until its motor has crossed the gap."""
    links = []
    for angles in q.reshape(runs, -1).tolist():
        link = angles[0]
        for motor in angles:
            link = min(max(link, motor - gap / 2), motor + gap / 2)
            links.append(link)
    return np.array(links)


def one_way_turns(extra):
    """A joint that never reverses, with a hidden torque `extra(q, v)`: four runs at different speeds."""
    t = np.arange(0.0, 4.0, 0.01)
    run, w, time_s = np.repeat(np.arange(4), len(t)), np.repeat([1.0, 2.0, 3.0, 1.5], len(t)), np.tile(t, 4)
    q, v = 5.0 * w * time_s - 2.0 / w * np.cos(w * time_s), 5.0 * w + 2.0 * np.sin(w * time_s)
    a = 2.0 * w * np.cos(w * time_s)
    noise = np.random.default_rng(1).normal(0.0, NOISE_NM, len(q))
    torque, phase = INERTIA * a + 0.1 * v + extra(q, v) + noise, np.full(len(q), -1)
    return ChannelData("axis", ChannelKind.REVOLUTE, time_s + 10.0 * run, q, v, a, torque, run, phase)


long_swings = partial(swings, runs=5)  # where what is tested goes by the number of runs
coarse_swings = partial(swings, rate_hz=125.0)  # for searches and diagnoses, which are slow


def read(data, *, step=0.0, noise=0.0, acceleration=True, seed=0):
    """The channel with a position read in steps or through noise, and derivatives made of that."""
    position = data.position + noise * np.random.default_rng(seed).standard_normal(len(data))
    position = step * np.round(position / step) if step else position
    made = differentiate(data.time_s, position, data.run)
    given = {"acceleration": made.acceleration} if acceleration else {}
    return replace(data, position=position, velocity=made.velocity, **given)


def smoothed(data, half):
    """The channel with derivatives that were made from its positions by one window."""
    velocity, acceleration = (channel_derivative(data, data.position, half, order) for order in (1, 2))
    return replace(data, velocity=velocity, acceleration=acceleration)


def within(data, half):
    """Samples whose window lies within their run."""
    number = np.arange(len(data)) % np.sum(data.run == 0)
    return (number >= 2 * half) & (number < number.max() - 2 * half)
