"""Linear problems with a known answer."""

import numpy as np
from scipy.signal import lfilter

from palpate.estimation.model import Regression

TRUTH = np.array([500.0, 20.0])
NAMES, UNITS = ("k", "c"), ("N/m", "N s/m")


def motion(count=900):
    """Depth and speed of three loadings, and their runs."""
    t = np.linspace(0.0, 1.0, count // 3)
    depth, speed = [], []
    for fastest in (0.15, 0.09, 0.06):
        depth.append(fastest / 8 * (1 - np.exp(-8 * t)))
        speed.append(fastest * np.exp(-8 * t))
    return np.column_stack([np.concatenate(depth), np.concatenate(speed)]), np.repeat([0, 1, 2], count // 3)


def problem(rng, *, count=900, noise=0.02, share=0.0, correlation=0.0, outliers=0.0, truth=TRUTH):
    """Kelvin-Voigt samples with noise that is even, grows with the force, is correlated, or has outliers."""
    columns, run = motion(count)
    force = columns @ truth
    white = rng.standard_normal(len(force))
    coloured = lfilter([np.sqrt(1 - correlation**2)], [1, -correlation], white)
    measured = force + (noise + share * force) * coloured
    wrong = rng.random(len(force)) < outliers
    measured = np.where(wrong, measured + rng.uniform(0.5, 6.0, len(force)), measured)
    return Regression(columns, measured, NAMES, UNITS, run=run)


def values(estimate):
    return np.array([parameter.value for parameter in estimate.parameters])


def std_errs(estimate):
    return np.array([parameter.std_err for parameter in estimate.parameters])


def covered(estimate, truth=TRUTH):
    """Which intervals hold the truth."""
    return np.array(
        [p.interval[0] <= true <= p.interval[1] for p, true in zip(estimate.parameters, truth, strict=True)]
    )
