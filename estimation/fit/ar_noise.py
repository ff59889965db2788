"""The colour of the noise, and how to take it out, so that least squares weighs what is really new."""

from dataclasses import dataclass

import numpy as np
import scipy

from palpate.robot_io.types import BoolArray, FloatArray, IntArray

ORDER = 4


@dataclass(frozen=True)
class ArNoise:
    """An autoregressive noise, run by run."""

    coefficients: FloatArray  # coefficients of the previous samples, newest first; empty for white noise

    def used(self, run: IntArray, trusted: BoolArray) -> BoolArray:
        """Samples that are trusted with all their past within their own run, shape (m,)."""
        order = len(self.coefficients)
        used = trusted.copy()
        used[:order] = False
        for lag in range(1, order + 1):
            used[order:] &= trusted[order - lag : len(run) - lag]
        used[order:] &= run[order:] == run[: len(run) - order]
        return used

    def whiten(self, signal: FloatArray) -> FloatArray:
        """What is new in each sample of `signal` (m,) or (m, k), same shape; rows of `used` count."""
        order = len(self.coefficients)
        if order == 0:
            return signal
        new = np.array(signal, dtype=np.float64)
        for lag, weight in enumerate(self.coefficients, start=1):
            new[order:] -= weight * signal[order - lag : len(signal) - lag]
        return new


WHITE = ArNoise(np.empty(0))


def estimate_ar_noise(residual: FloatArray, run: IntArray, trusted: BoolArray) -> ArNoise:
    """Fit the noise colour to residuals (Yule-Walker, pooled over runs; the mean is part of the noise)."""
    clean = np.where(trusted, residual, 0.0)
    products = np.empty(ORDER + 1)
    for lag in range(ORDER + 1):
        same = run[lag:] == run[: len(run) - lag]
        products[lag] = np.sum((clean[lag:] * clean[: len(clean) - lag])[same])
    if not products[0] > 0.0:
        return WHITE
    products[0] *= 1.0 + 1e-6
    return ArNoise(scipy.linalg.solve_toeplitz(products[:-1], products[1:]))
