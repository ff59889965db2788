"""Local cubic fits to evenly spaced samples (A. Savitzky, M. Golay, Analytical Chemistry 36 (1964))."""

from functools import lru_cache
from math import perm

import numpy as np

from palpate.robot_io.types import FloatArray

DEGREE = 3  # of the polynomials; windows of fewer than four samples have a lower degree


@lru_cache(maxsize=256)
def fit_weights(width: int, order: int) -> FloatArray:
    """Return the weights of a derivative of a local fit at each sample of a window.

    Args:
        width: number of evenly spaced samples in the window.
        order: order of the derivative by the index of the sample, 0 for the fit itself.

    Returns:
        Weights of the samples (columns) for the derivative at each sample (rows), shape (width, width).
    """
    half = max(0.5 * (width - 1), 0.5)
    place = (np.arange(width) - 0.5 * (width - 1))[:, None] / half
    power = np.arange(min(DEGREE, width - 1) + 1)
    factors = np.array([perm(k, order) for k in power.tolist()]) / half**order
    weights: FloatArray = factors * place ** np.maximum(power - order, 0) @ np.linalg.pinv(place**power)
    weights.setflags(write=False)
    return weights


def even_derivative(signal: FloatArray, width: int, order: int) -> FloatArray:
    """Differentiate evenly sampled signals with respect to the sample index, in the shape of the signals.

    The fit covers the window around each sample, or the first or last window of a signal.

    Args:
        signal: one or several signals, shape (n,) or (k, n), n at least `width`.
        width: number of samples in a window, odd or n.
        order: order of the derivative, 0 for the smoothed signal.
    """
    weights, half = fit_weights(width, order), width // 2
    middle = np.zeros(signal.size)  # windows that span two signals are not used
    middle[: signal.size - width + 1] = np.correlate(signal.ravel(), weights[half])
    inside = middle.reshape(signal.shape)[..., : signal.shape[-1] - width + 1]
    ends = signal[..., :width] @ weights[:half].T, signal[..., -width:] @ weights[half + 1 :].T
    return np.concatenate([ends[0], inside, ends[1]], axis=-1)
