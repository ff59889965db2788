"""Noise of a wanted colour."""

import numpy as np
from scipy.signal import lfilter


def coloured(rng: np.random.Generator, count: int, std: float, correlation: float) -> np.ndarray:
    """AR(1) noise of this standard deviation, `correlation` from one sample to the next."""
    steps = rng.normal(0.0, std * np.sqrt(1.0 - correlation**2), count + 2000)
    return np.asarray(lfilter([1.0], [1.0, -correlation], steps))[2000:]
