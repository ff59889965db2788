"""Smoothing bias of derived motion: the parts that smoothing removed, as columns of a linear fit.

A filter that derives velocity and acceleration flattens their peaks, which causes a systematic error of the
prediction (W. A. Fuller, Measurement Error Models (1987)).
"""

from functools import lru_cache

import numpy as np
import scipy

from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.fit_problem import FitProblem, Solution
from palpate.estimation.fit.normal_equations import LinearFit
from palpate.estimation.signals.blocks import equal_length_blocks
from palpate.estimation.signals.local_polynomials import fit_weights
from palpate.robot_io.types import FloatArray, IntArray

_MOST_TIMES = 3.0  # largest plausible multiple of the expected smoothing bias
_MOST_UNLIKE = 0.2  # largest share of a change that smoothing cannot describe, if it may cause the change
_CONTAINED = 0.5  # least part of a change that a smoothed effort contains, unless smoothing causes the change
_PASSES = 4  # number of times that a residual is smoothed before its slow part remains
_MOSTLY = 0.5  # share of the fall of the squared residual
_POWERS = 3  # powers of the smoothing operator, a series that approximates its inverse
# A half window [samples], and the order of the derivative for which it was used.
DerivativeWindow = tuple[int, int]
# Windows that derived velocity and acceleration; empty if a model does not use the signal.
DifferentiationFilter = tuple[tuple[DerivativeWindow, ...], tuple[DerivativeWindow, ...]]


def fit_smoothing_bias(
    problem: FitProblem, solution: Solution, filters: DifferentiationFilter
) -> tuple[FloatArray, LinearFit | None]:
    """Fit a model's gains jointly with the smoothing bias of its motion, if that reduces the held-out error.

    Args:
        problem: data on m blocks.
        solution: the fitted model with q gains; its gains at bounds stay fixed.
        filters: the windows that derived velocity and acceleration.

    Returns:
        Columns of smoothing bias [effort], shape (m, k), and the fit of q + k gains; k = 0 and None if the
        columns do not improve the model or are implausibly large.
    """
    bias = smoothing_bias(problem.blocked, problem.blocked.effort - solution.residual, filters)
    if bias.size:
        names = list(solution.model.gains)
        held = {name: solution.parameters[name] for name in solution.fixed}
        fit = problem.solve(np.hstack([solution.columns, bias]), solution.target, names, held)
        is_better = fit.held_out.sum() <= solution.held_out
        if is_better and _is_plausible_bias(bias, fit.gains[len(names) :]):
            return bias, fit
    return bias[:, :0], None


def _is_plausible_bias(bias: FloatArray, gains: FloatArray) -> bool:
    """Check that the fitted smoothing bias is at most a few times the bias expected from the filters."""
    # With arbitrary gains, columns of smoothing bias could imitate a missing law, such as a spring.
    expected = bias[:, -1]  # smoothing bias of the effort for the filter that removes most
    return bool(np.sum((bias @ gains) ** 2) <= _MOST_TIMES**2 * np.sum(expected**2))


def looks_like_smoothing(
    problem: FitProblem, effort: FloatArray, change: FloatArray, filters: DifferentiationFilter
) -> bool:
    """Return whether the smoothing of the motion may cause most of a change of the predicted effort.

    Args:
        problem: data on m blocks.
        effort: predicted effort on blocks, shape (m,) [effort].
        change: change of the predicted effort, shape (m,) [effort].
        filters: the windows that derived velocity and acceleration.
    """
    bias = smoothing_bias(problem.blocked, effort, filters)[problem.used]
    if not bias.size:
        return False
    change = change[problem.used]
    gains = np.asarray(np.linalg.lstsq(bias, change, rcond=None)[0], dtype=np.float64)
    is_like = np.sum((change - bias @ gains) ** 2) <= _MOST_UNLIKE * np.sum(change**2)
    return bool(is_like) and _is_plausible_bias(bias, gains)


def is_in_smoothed_effort(
    problem: FitProblem, solution: Solution, change: FloatArray, filters: DifferentiationFilter
) -> bool:
    """Return whether the effort, smoothed like the motion, still contains a change of the prediction.

    If the filters of the motion cause the change, the model without it describes the smoothed effort. For
    example, an effort with sharp corners looks like a saturation beside an acceleration with rounded corners.

    Args:
        problem: data on m blocks.
        solution: the model without the change.
        change: change of the predicted effort, shape (m,) [effort].
        filters: the windows that derived velocity and acceleration.
    """
    blocked, used = problem.blocked, problem.used

    def smooth(signal: FloatArray) -> FloatArray:
        for half, order in filters[1] or filters[0]:
            signal = _convolve(signal, smoothing_kernel(half, order, blocked.rows.shape[1]), blocked.run)
        return signal

    # Both sides are smoothed once more, since the noise of a derived acceleration resembles its corners.
    left = smooth(smooth(blocked.effort) - (blocked.effort - solution.residual))
    columns, added = smooth(solution.columns)[used], smooth(change)
    beyond_model = added[used] - columns @ np.linalg.lstsq(columns, added[used], rcond=None)[0]
    return bool(left[used] @ beyond_model >= _CONTAINED * (smooth(added)[used] @ beyond_model))


def is_below_cutoff(
    problem: FitProblem, before: FloatArray, after: FloatArray, filters: DifferentiationFilter
) -> bool:
    """Return whether a residual falls mostly at frequencies that the filters of the motion pass.

    Above them, the smoothing of the motion may cause what an effect explains.

    Args:
        problem: data on m blocks.
        before: residual of a model, shape (m,) [effort].
        after: residual of a better model, shape (m,) [effort].
        filters: the windows that derived velocity and acceleration.
    """
    blocked = problem.blocked
    half, order = max((*filters[0], *filters[1]))
    if round(half / blocked.rows.shape[1]) == 0:
        return True
    kernel = smoothing_kernel(half, order, blocked.rows.shape[1])
    slow = [np.where(blocked.trusted, residual, 0.0) for residual in (before, after)]
    fall = float(np.subtract(*(np.sum(residual**2) for residual in slow)))
    for _ in range(_PASSES):
        slow = [_convolve(residual, kernel, blocked.run) for residual in slow]
    return float(np.subtract(*(np.sum(residual**2) for residual in slow))) > _MOSTLY * fall


def smoothing_bias(blocked: BlockedData, effort: FloatArray, filters: DifferentiationFilter) -> FloatArray:
    """Compute columns (m, k) of the parts that smoothing removed from velocity, acceleration and effort.

    Each column is a sum of powers that restores a signal; the last ones restore the effort, the largest one
    last. The powers of the acceleration have separate columns, since it also contains the most noise.

    Args:
        blocked: the channel on m blocks.
        effort: predicted effort on blocks, shape (m,) [effort].
        filters: the windows that derived velocity and acceleration.
    """
    data, block = blocked.data, blocked.rows.shape[1]
    velocity, acceleration = (blocked.reduce(s * data.engaged) for s in (data.velocity, data.acceleration))
    every = tuple(sorted({*filters[0], *filters[1]}))
    columns = [np.empty((len(effort), 0))]
    for signal, windows in zip((velocity, acceleration, effort), (*filters, every), strict=True):
        parts = []
        for half, order in windows:
            if round(half / block) > 0:
                kernel = smoothing_kernel(half, order, block)
                powers = [signal]  # the kernel's high-pass complement, applied repeatedly: van Cittert (1931)
                for _ in range(_POWERS):
                    powers.append(powers[-1] - _convolve(powers[-1], kernel, blocked.run))
                residues = np.column_stack(powers[1:])
                parts.append(residues if signal is acceleration else residues.sum(axis=1, keepdims=True))
        # A second derivative removes more than a first one from a wider window.
        columns.extend(sorted(parts, key=np.linalg.norm))
    return np.hstack(columns)


@lru_cache(maxsize=256)
def smoothing_kernel(half: int, order: int, block: int = 1) -> FloatArray:
    """Return weights (2 r + 1,) with which a local polynomial fit averages the derivative that it estimates.

    They are repeated sums of the weights of the fit, since a derivative's integral is the fitted signal. The
    result has the weights of neighboring blocks; it is symmetric, with sum 1.

    Args:
        half: number of samples on each side in a fit.
        order: order of the derivative.
        block: number of samples in a block.
    """
    weights = fit_weights(2 * half + 1, order)[half]
    for _ in range(order):
        weights = np.cumsum(weights[::-1])[::-1][1:]
    place = (np.arange(len(weights)) - 0.5 * (len(weights) - 1)) / block
    below, reach = np.floor(place).astype(np.int64), 1 - (-half // block)
    t, kernel = place - below, np.zeros(2 * reach + 1)
    # Weights of four blocks in a cubic interpolation, which change no moment of the kernel up to the third.
    cubic = (2 - t) * (1 - t) * -t / 6, (2 - t) * (1 - t) * (1 + t) / 2, (2 - t) * t * (1 + t) / 2
    for number, part in enumerate((*cubic, (1 - t) * -t * (1 + t) / 6), start=-1):
        np.add.at(kernel, below + number + reach, weights * part)
    kernel /= kernel.sum()
    kernel.setflags(write=False)
    return kernel


def _convolve(signal: FloatArray, kernel: FloatArray, run: IntArray) -> FloatArray:
    smooth = np.empty_like(signal)
    for rows in equal_length_blocks(run):
        smooth[rows] = scipy.ndimage.convolve1d(signal[rows], kernel, axis=1, mode="nearest")
    return smooth
