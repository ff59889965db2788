"""Simulate how sensors and files record motion and effort: steps, noise, sampling, digits."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter, savgol_filter

from .motion import Array, TrueMotion

LINKS_M = (0.30, 0.25, 0.10)


@dataclass(frozen=True)
class ReadingChain:
    """How a case is recorded; drawn once."""

    rate_hz: float  # sample rate
    irregular: bool  # times jitter, and some rows are lost
    steps: tuple[int, ...]  # encoder steps per turn: one entry for a joint, three for an arm's tip
    digits_m: float  # rounding of a printed position; 0 for none
    velocity: str  # "none" (the file has no such column), "derived" (by its user) or "given" (a tachometer)
    color: str  # color of the effort's noise: "white", "ar1" or "proportional"


def draw_reading(rng: Generator, kind: str) -> ReadingChain:
    """Draw one of the common ways of recording."""
    fine = [2**19, 2**17, 2**16]
    if kind == "contact":
        chain = rng.choice(["arm", "coarse arm", "digits"], p=[0.5, 0.25, 0.25])
        per_turn = {"arm": rng.choice(fine, 3), "coarse arm": [4096] * 3, "digits": []}[chain]
        digits = float(rng.choice([1e-5, 1e-6])) if chain == "digits" else 0.0
    else:
        per_turn, digits = [rng.choice([4096, 16384, 2**17, 2**19])], 0.0
    return ReadingChain(
        rate_hz=float(rng.choice([100, 250, 500, 1000], p=[0.2, 0.25, 0.3, 0.25])),
        irregular=bool(rng.random() < 0.2),
        steps=tuple(int(n) for n in per_turn),
        digits_m=digits,
        velocity=str(rng.choice(["none", "derived", "given"], p=[0.5, 0.3, 0.2])),
        color=str(rng.choice(["white", "ar1", "proportional"], p=[0.5, 0.25, 0.25])),
    )


def sample_times(rng: Generator, reading: ReadingChain, motion: TrueMotion) -> Array:
    """Return the times of the samples, run by run [s]."""
    times = []
    for rows in motion.each():
        t = motion.t[rows]
        at = np.arange(t[0], t[-1], 1 / reading.rate_hz)
        if reading.irregular:
            at = at + rng.uniform(-0.35, 0.35, len(at)) / reading.rate_hz
            at = np.clip(at[rng.random(len(at)) > 0.02], t[0], t[-1])
            at = np.unique(at)
        times.append(at)
    return np.concatenate(times)


def read_position(rng: Generator, reading: ReadingChain, x: Array, *, arm: bool) -> Array:
    """Return a position rounded by encoder steps, or printed with few digits."""
    if reading.digits_m:
        return np.round(x / reading.digits_m) * reading.digits_m
    steps = [2 * np.pi / n for n in reading.steps]
    if not arm:
        return np.round(x / steps[0]) * steps[0]
    # The tip of a three-link arm moves down a vertical line with the tool pointing down: inverse kinematics
    # of the wrist at (r, z), angles rounded to the encoders' steps, and forward kinematics of these.
    a, b, tool = LINKS_M
    reach, height = rng.uniform(0.30, 0.42), rng.uniform(-0.05, 0.1)
    z = height - x  # positive depth is downwards
    elbow = np.arccos((reach**2 + z**2 - a**2 - b**2) / (2 * a * b))
    shoulder = np.arctan2(z, reach) - np.arctan2(b * np.sin(elbow), a + b * np.cos(elbow))
    wrist = -np.pi / 2 - shoulder - elbow
    zero = rng.uniform(0, 1, 3)
    first, second, third = (
        (np.round(angle / step + start) - start) * step
        for angle, step, start in zip((shoulder, elbow, wrist), steps, zero, strict=True)
    )
    tip = a * np.sin(first) + b * np.sin(first + second) + tool * np.sin(first + second + third)
    return (height - tool) - tip


def noise(rng: Generator, reading: ReadingChain, effort: Array) -> Array:
    """Return noise of RMS 1: white, first-order autoregressive over 10 samples, or growing with effort."""
    white = rng.standard_normal(len(effort))
    if reading.color == "ar1":
        return np.sqrt(1 - 0.9**2) * lfilter([1.0], [1.0, -0.9], white)
    if reading.color == "proportional":
        size = 0.25 + np.abs(effort) / np.abs(effort).max()
        return white * size / np.sqrt(np.mean(size**2))
    return white


def smoothed(x: Array, rate_hz: float, run: Array, seconds: float, order: int) -> Array:
    """Return a derivative of a read position by quadratic fits over a window (Savitzky and Golay 1964)."""
    out = np.zeros_like(x)
    for number in np.unique(run):
        rows = run == number
        width = min(max(5, int(seconds * rate_hz) | 1), (rows.sum() - 1) | 1)
        out[rows] = savgol_filter(x[rows], width, 2, deriv=order, delta=1 / rate_hz)
    return out


def best_derivative(x: Array, true: Array, rate_hz: float, run: Array, order: int) -> Array:
    """Return the best such derivative, with the window chosen by the truth."""
    tries = [smoothed(x, rate_hz, run, seconds, order) for seconds in (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)]
    return min(tries, key=lambda derivative: float(np.mean((derivative - true) ** 2)))


def slope(times: Array, x: Array, run: Array, half: int) -> Array:
    """Return central differences over `half` samples to either side, run by run."""
    out = np.zeros_like(x)
    for number in np.unique(run):
        rows = np.flatnonzero(run == number)
        index = np.arange(len(rows))
        before, after = rows[np.maximum(index - half, 0)], rows[np.minimum(index + half, len(rows) - 1)]
        out[rows] = (x[after] - x[before]) / (times[after] - times[before])
    return out
