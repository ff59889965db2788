"""Operators with memory, each started afresh in every run."""

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter, savgol_filter

from estimation.signals.blocks import blocks
from robot_io.types import FloatArray, IntArray


def sample_time(time_s: FloatArray, run: IntArray) -> float:
    """Median time between samples of one run [s]; 1.0 where there is no second sample."""
    steps = np.diff(time_s)[np.diff(run) == 0]
    return float(np.median(steps)) if len(steps) else 1.0


def per_run(operator: Callable[[FloatArray], FloatArray], signal: FloatArray, run: IntArray) -> FloatArray:
    """`operator` applied to each run's rows of `signal`, shape (n,) or (n, k)."""
    result = np.empty_like(signal, dtype=np.float64)
    for rows in blocks(run):
        result[rows] = operator(np.asarray(signal[rows], dtype=np.float64))
    return result


def relax(signal: FloatArray, time_s: FloatArray, run: IntArray, tau_s: float) -> FloatArray:
    """What is left of a strain as it relaxes: z' = signal' - z / tau, from z = 0 before each run."""
    return signal - low_pass(signal, time_s, run, tau_s, from_rest=True)


def low_pass(
    signal: FloatArray, time_s: FloatArray, run: IntArray, tau_s: float, *, from_rest: bool = False
) -> FloatArray:
    """First-order lag, exact for a signal that goes straight from sample to sample.

    Args:
        signal: shape (n,) or (n, k).
        time_s: times [s].
        run: run of each sample.
        tau_s: time constant [s].
        from_rest: start from zero; else from the run's first sample.
    """
    ratio = sample_time(time_s, run) / max(tau_s, 1e-9)
    decay = np.exp(-ratio)
    newest = 1.0 - (1.0 - decay) / ratio
    older = (1.0 - decay) / ratio - decay

    def one_run(values: FloatArray) -> FloatArray:
        first = values[:1] * (0.0 if from_rest else 1.0 - newest)
        filtered, _ = lfilter([newest, older], [1.0, -decay], values, axis=0, zi=first)
        return np.asarray(filtered)

    return per_run(one_run, signal, run)


def shift(signal: FloatArray, time_s: FloatArray, run: IntArray, delay_s: float) -> FloatArray:
    """The signal `delay_s` ago, straight between samples; before a run's start its first value."""
    steps = delay_s / sample_time(time_s, run)

    def one_run(values: FloatArray) -> FloatArray:
        index = np.clip(np.arange(len(values)) - steps, 0, len(values) - 1)
        low = np.floor(index).astype(np.int64)
        high = np.minimum(low + 1, len(values) - 1)
        part = (index - low).reshape(-1, *([1] * (values.ndim - 1)))
        return np.asarray((1.0 - part) * values[low] + part * values[high])

    return per_run(one_run, signal, run)


def play(signal: FloatArray, run: IntArray, half_width: float) -> FloatArray:
    """Backlash operator: follows the signal only once it has crossed a gap of twice `half_width`.

    Columns of (n, k) are independent. The gap starts centred on each run's first sample.
    """

    def one_run(values: FloatArray) -> FloatArray:
        flat = values.reshape(len(values), -1)
        columns = [_play(flat[:, column], half_width) for column in range(flat.shape[1])]
        return np.array(columns).T.reshape(values.shape)

    return per_run(one_run, signal, run)


def _play(values: FloatArray, half_width: float) -> FloatArray:
    """Play of one signal (n,): only where it turns does the past matter, between turns it goes one way."""
    steps = np.diff(values)
    moving = np.flatnonzero(steps)
    turns = moving[1:][np.diff(np.sign(steps[moving])) != 0]
    starts = np.concatenate([[0], turns]).astype(np.int64)
    rising = values[np.append(turns, len(values) - 1)] >= values[starts]
    state, states = float(values[0]), []
    for is_rising, end in zip(
        rising.tolist(), values[np.append(turns, len(values) - 1)].tolist(), strict=True
    ):
        states.append(state)
        state = max(state, end - half_width) if is_rising else min(state, end + half_width)
    piece = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(values))))
    before = np.array(states)[piece]
    played: FloatArray = np.where(
        rising[piece], np.maximum(before, values - half_width), np.minimum(before, values + half_width)
    )
    return played


def direction(velocity: FloatArray, time_s: FloatArray, run: IntArray, presliding: float) -> FloatArray:
    """Direction of motion in [-1, 1], (n,): it turns round over a path of `presliding`, and stays at rest."""
    signed = velocity * (sample_time(time_s, run) / presliding)
    return per_run(_direction, signed, run)


def _direction(steps: FloatArray) -> FloatArray:
    """Between turns s goes to the sign of motion as exp(-path), so only the turns need a loop; (n,)."""
    sign = np.where(steps >= 0.0, 1.0, -1.0)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(sign)) + 1])
    piece = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(steps))))
    path = np.cumsum(np.abs(steps))
    path -= np.concatenate([[0.0], path[starts[1:] - 1]])[piece]
    kept = np.exp(-path)
    ends = np.append(starts[1:], len(steps)) - 1
    state, states = 0.0, []
    for way, left in zip(sign[starts].tolist(), kept[ends].tolist(), strict=True):
        states.append(state)
        state = way + (state - way) * left
    moved: FloatArray = sign + (np.array(states)[piece] - sign) * kept
    return moved


def running_max(signal: FloatArray, run: IntArray) -> FloatArray:
    """Largest value since the run began."""
    return per_run(np.maximum.accumulate, signal, run)


def rate(signal: FloatArray, time_s: FloatArray, run: IntArray, order: int = 1) -> FloatArray:
    """Derivative of a signal (n,) without phase error, smoothed over five samples."""
    step = sample_time(time_s, run)

    def one_run(values: FloatArray) -> FloatArray:
        if len(values) < 5:
            return np.zeros_like(values)
        return np.asarray(savgol_filter(values, 5, 3 if order == 1 else 4, deriv=order, delta=step))

    return per_run(one_run, signal, run)
