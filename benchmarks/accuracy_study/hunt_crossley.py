"""Hunt-Crossley with 30 % outliers: what the fit's loss is worth."""

import numpy as np

from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.fitting.fit import Fit, fit
from estimation.fitting.loss import Loss
from estimation.models import MODELS
from estimation.statistics.least_squares import solve
from robot_io.types import FloatArray

TRUTH = {"hunt_crossley.k": 2000.0, "hunt_crossley.b": 1500.0, "hunt_crossley.n": 1.3}
SAMPLES = 2000
NOISE_N = 0.02
OUTLIERS = 0.3


def press(rng: np.random.Generator, outliers: float) -> ChannelData:
    """Pressing in and out up to 12 mm with rising frequency; outliers of -1 to 4 N."""
    time_s = np.arange(SAMPLES) * 1e-3
    phase = 2 * np.pi * (1.5 * time_s + 2 * time_s**2)
    depth = 1e-4 + 0.006 * (1 - np.cos(phase))
    speed = 0.006 * np.sin(phase) * 2 * np.pi * (1.5 + 4 * time_s)
    k, b, n = TRUTH.values()
    force = k * depth**n + b * depth**n * speed + NOISE_N * rng.standard_normal(SAMPLES)
    wrong = rng.random(SAMPLES) < outliers
    force = np.where(wrong, force + rng.uniform(-1.0, 4.0, SAMPLES), force)
    zero = np.zeros(SAMPLES)
    number = np.zeros(SAMPLES, dtype=np.int64)
    return ChannelData("contact", ChannelKind.CONTACT, time_s, depth, speed, zero, force, number, number)


def log_linear(data: ChannelData) -> FloatArray:
    """Solve ln F = ln k + n ln x + (b/k) v, for slow motion, little noise (Haddadi 2012)."""
    pushing = data.effort > 0
    x, v, force = data.position[pushing], data.velocity[pushing], data.effort[pushing]
    log_k, n, ratio = solve(np.column_stack([np.ones(len(x)), np.log(x), v]), np.log(force)).gains
    return np.array([np.exp(log_k), ratio * np.exp(log_k), n])


def bound(data: ChannelData, found: Fit) -> FloatArray:
    """Cramer-Rao bound of clean data with this noise, relative to the truth."""
    truth = np.array(list(TRUTH.values()))
    clean = np.linalg.inv(found.jacobian.T @ found.jacobian) * NOISE_N**2
    return np.sqrt(np.diag(clean)) / truth


def run_study(draws: int) -> None:
    """Print root mean square errors in %."""
    model = MODELS["hunt_crossley"]().build(ModelContext())
    truth = np.array(list(TRUTH.values()))
    print(f"\nHunt-Crossley, {SAMPLES} samples, noise {NOISE_N} N, {draws} draws")
    print("Root mean square errors of k / b / n in %\n")
    for outliers in (0.0, OUTLIERS):
        errors: dict[str, list[FloatArray]] = {"log-linear": [], **{str(loss): [] for loss in Loss}}
        for draw in range(draws):
            data = press(np.random.default_rng(draw), outliers)
            errors["log-linear"].append(log_linear(data) / truth - 1)
            for loss in Loss:
                found = fit(model, data, loss=loss)
                errors[str(loss)].append(np.array(list(found.parameters.values())) / truth - 1)
        print(f"{100 * outliers:g} % outliers")
        for name, each in errors.items():
            print(f"  {name:24s} {_percent(np.sqrt(np.mean(np.square(each), axis=0)))}")
    print(f"  {'Cramer-Rao, no outliers':24s} {_percent(bound(data, found))}")


def _percent(values: FloatArray) -> str:
    return " / ".join(f"{100 * value:.3g}" for value in values)
