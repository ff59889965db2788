"""Operators with memory, each started afresh in every run."""

from collections.abc import Callable
from functools import cache
from math import perm

import numpy as np

from estimation.signals.blocks import blocks, cut, places
from estimation.signals.cache_by_array import of_arrays
from robot_io.types import FloatArray, IntArray

_WINDOW = 5  # samples over which a rate is smoothed
_EVEN = 0.01  # of the usual step, by which steps may differ and still be alike
_ALL = slice(None)
_STEADY_S = 0.025  # in which a probing tip turns round only once


@of_arrays
def sample_time(time_s: FloatArray, run: IntArray) -> float:
    """Median time between samples of one run [s]; 1.0 where there is no second sample."""
    steps = (time_s[1:] - time_s[:-1])[run[1:] == run[:-1]]
    if not len(steps):
        return 1.0
    middle = len(steps) // 2
    low = middle - 1 + len(steps) % 2
    steps.partition((low, middle))  # numpy's own median spends most of its time on what it might be asked
    return float(0.5 * (steps[low] + steps[middle]))


def finest_step(time_s: FloatArray, run: IntArray) -> float:
    """Time between samples where they are densest [s]: a twentieth are as close; see `sample_time`."""
    steps = (time_s[1:] - time_s[:-1])[run[1:] == run[:-1]]
    return float(np.quantile(steps, 0.05)) if len(steps) else 1.0


def per_run(operator: Callable[[FloatArray], FloatArray], signal: FloatArray, run: IntArray) -> FloatArray:
    """`operator` applied to each run's rows of `signal`, shape (n,) or (n, k)."""
    result = np.empty_like(signal, dtype=np.float64)
    for rows in blocks(run):
        result[rows] = operator(np.asarray(signal[rows], dtype=np.float64))
    return result


@of_arrays
def is_even(time_s: FloatArray, run: IntArray) -> bool:
    """Whether samples come at one rate."""
    step_s = sample_time(time_s, run)
    steps = (time_s[1:] - time_s[:-1])[run[1:] == run[:-1]]
    return bool((np.abs(steps - step_s) <= _EVEN * step_s).all())


def shift(signal: FloatArray, time_s: FloatArray, run: IntArray, delay_s: float) -> FloatArray:
    """The signal (n,) or (n, k) as it was `delay_s` ago; beyond a run's ends its first or last value.

    A cubic goes through the four samples around each time (two and two), so that a shift by a part of a
    sample smooths nothing; straight between the first two samples of a run, and the last two.
    """
    signal = np.asarray(signal, dtype=np.float64)
    starts, piece = places(run)
    if len(starts) == len(signal):
        return signal.copy()
    step_s = sample_time(time_s, run)
    if not is_even(time_s, run):
        return _between(signal, time_s, run, delay_s)
    newest = int(np.ceil(delay_s / step_s)) - 2  # samples ago, of the four
    weights = _cubic_weights(np.arange(4.0)[None, :], np.array([delay_s / step_s - newest]))[0]
    shifted = sum(weight * np.roll(signal, newest + i, axis=0) for i, weight in enumerate(weights.tolist()))
    place, end = np.arange(len(signal)) - newest, np.append(starts[1:], len(run))[piece]
    rows = np.flatnonzero((place - 3 < starts[piece]) | (place >= end))
    shifted[rows] = _between(signal, time_s, run, delay_s, rows)
    return np.asarray(shifted)


def _between(
    signal: FloatArray, time_s: FloatArray, run: IntArray, delay_s: float, rows: IntArray | slice = _ALL
) -> FloatArray:
    """See `shift`: at these rows, for samples at any times."""
    starts, piece = places(run)
    clock = _one_clock(time_s, starts, abs(delay_s))
    first, last = starts[piece][rows], np.append(starts[1:], len(run))[piece][rows] - 1
    wanted = np.clip(clock[rows] - delay_s, clock[first], clock[last])
    alone = first == last
    after = np.where(alone, first, np.clip(np.searchsorted(clock, wanted), first + 1, last))
    before = np.where(alone, first, after - 1)
    inside = (before - 1 >= first) & (after + 1 <= last)
    part = (clock[after] - wanted) / np.where(alone, 1.0, clock[after] - clock[before])
    part = part.reshape(-1, *([1] * (signal.ndim - 1)))
    shifted: FloatArray = part * signal[before] + (1.0 - part) * signal[after]
    around = after[inside][:, None] + np.arange(-2, 2)
    weights = _cubic_weights(clock[around], wanted[inside])
    shifted[inside] = np.einsum("nj,nj...->n...", weights, signal[around])
    return shifted


def _one_clock(time_s: FloatArray, starts: IntArray, apart_s: float) -> FloatArray:
    """Times [s] (n,) that increase from run to run too, by more than `apart_s`."""
    steps = np.diff(time_s, prepend=time_s[:1])
    steps[starts] = 2.0 * apart_s + 1.0
    return np.cumsum(steps)


def _cubic_weights(times: FloatArray, wanted: FloatArray) -> FloatArray:
    """Lagrange's weights (n, 4) of samples at four times (n, 4) for the cubic's value at `wanted` (n,)."""
    weights = np.ones_like(times)
    for one in range(4):
        for other in range(4):
            if other != one:
                weights[:, one] *= (wanted - times[:, other]) / (times[:, one] - times[:, other])
    return weights


def play(signal: FloatArray, run: IntArray, half_width: float, start: FloatArray | None = None) -> FloatArray:
    """Backlash operator: follows the signal only once it has crossed a gap of twice `half_width`.

    Columns of (n, k) are independent. Each run starts from its `start`, shape (runs,) or (runs, k), as far
    as the gap allows; without one the gap starts centred on the run's first sample.

    A sample clamps the state between its own two ends of the gap, and clamps in a row are one clamp:
    stretches of samples are first condensed to one clamp each, all side by side, then entered with their own
    states.
    """
    if signal.size == 0:
        return signal.astype(np.float64)
    first = [rows.start for rows in blocks(run)]
    low, high = signal - half_width, signal + half_width
    start = signal[first] if start is None else np.clip(start, low[first], high[first])
    low[first] = high[first] = start
    length = int(np.sqrt(len(signal))) + 1
    low, high = cut(low, length), cut(high, length)
    least, most = low[0], high[0]
    for low_now, high_now in zip(low[1:], high[1:], strict=True):
        least = np.minimum(np.maximum(least, low_now), high_now)
        most = np.minimum(np.maximum(most, low_now), high_now)
    state = np.empty_like(least)
    state[0] = low[0, 0]
    for number in range(1, len(state)):
        state[number] = np.minimum(np.maximum(state[number - 1], least[number - 1]), most[number - 1])
    played = np.empty_like(low)
    for place in range(length):
        state = np.minimum(np.maximum(state, low[place]), high[place], out=played[place])
    together = played.swapaxes(0, 1).reshape(length * len(state), *signal.shape[1:])
    return np.asarray(together[: len(signal)])


@of_arrays
def steadied(position: FloatArray, time_s: FloatArray, run: IntArray) -> FloatArray:
    """Position (n,) without the encoder's jitter, whose way back and forth adds up: a cubic through 25 ms."""
    half = int(0.5 * _STEADY_S / sample_time(time_s, run))
    window, steady = 2 * half + 1, np.array(position, dtype=np.float64)
    if not 3 < window <= len(position):
        return steady
    weights = _cubic(window)
    steady[half:-half] = np.convolve(position, weights[half, ::-1], mode="valid")
    for rows in blocks(run):
        values, found = position[rows], steady[rows]
        if len(values) < window:
            found[:] = values
        else:
            found[:half], found[-half:] = (
                weights[:half] @ values[:window],
                weights[-half:] @ values[-window:],
            )
    return steady


@cache
def _cubic(window: int) -> FloatArray:
    """What turns the samples of a window into their cubic at each of them, (window, window)."""
    place = np.linspace(-1.0, 1.0, window)
    power = place[:, None] ** np.arange(4.0)
    return np.asarray(power @ np.linalg.pinv(power))


def direction(
    position: FloatArray, run: IntArray, presliding: float, way: FloatArray | None = None
) -> FloatArray:
    """Direction of motion in [-1, 1], (n,): it turns round over a path of `presliding`, and stays at rest.

    Args:
        position: shape (n,).
        run: shape (n,); each begins at 0.
        presliding: path over which all but 1/e of a turn is made.
        way: direction that it goes to, shape (n,); None for the sign of each step.
    """
    first, _ = places(run)
    steps = np.diff(position, prepend=position[:1])
    kept, state = np.exp(-np.abs(steps) / presliding), np.sign(steps) if way is None else way.copy()
    kept[first] = state[first] = 0.0
    state *= 1.0 - kept
    reach = 1  # s = kept s_before + (1 - kept) way, of twice as many steps each time
    while reach < len(state) and np.any(kept[reach:]):
        state[reach:] += kept[reach:] * state[:-reach]
        kept[reach:] *= kept[:-reach]
        reach *= 2
    return state


def running_max(signal: FloatArray, run: IntArray) -> FloatArray:
    """Largest value since the run began."""
    return per_run(np.maximum.accumulate, signal, run)


def rate(signal: FloatArray, time_s: FloatArray, run: IntArray, order: int = 1) -> FloatArray:
    """Derivative of a signal (n,) without phase error, smoothed over five samples; 0 in shorter runs."""
    slopes = _slopes(order) / sample_time(time_s, run) ** order
    derivative = np.zeros(len(signal))
    if len(signal) < _WINDOW:
        return derivative
    derivative[2:-2] = sum(weight * signal[i : len(signal) - 4 + i] for i, weight in enumerate(slopes[2]))
    for rows in blocks(run):
        values, found = signal[rows], derivative[rows]
        if len(values) < _WINDOW:
            found[:] = 0.0
        else:
            found[:2], found[-2:] = slopes[:2] @ values[:_WINDOW], slopes[-2:] @ values[-_WINDOW:]
    return derivative


@cache
def _slopes(order: int) -> FloatArray:
    """What turns five samples into the derivative of their cubic (or quartic) at each of them, (5, 5)."""
    place = np.arange(_WINDOW) - _WINDOW // 2
    power = np.arange(4 if order == 1 else 5)
    fitted = np.linalg.pinv(place[:, None] ** power.astype(np.float64))
    falling = np.array([float(perm(int(k), order)) for k in power])
    derived: FloatArray = falling * place[:, None] ** np.maximum(power - order, 0.0)
    return derived @ fitted
