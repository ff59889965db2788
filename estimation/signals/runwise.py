"""Operators that act run by run: filters, delay, play, hysteresis and shifted motion."""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import permutations

import numpy as np
import scipy

from palpate.estimation.channel import ChannelData
from palpate.estimation.signals.blocks import block_index, blocks, equal_length_blocks, split_columns
from palpate.estimation.signals.cache_by_array import cache_by_array
from palpate.estimation.signals.local_polynomials import even_derivative
from palpate.robot_io.types import FloatArray, IntArray

_WINDOW = 5  # samples over which a derivative is smoothed
_UNEVENNESS = 0.01  # largest relative difference of steps in even sampling
# Time in which a probing tip reverses at most once, and its largest share of the longest run.
_JITTER_WINDOW_S, _JITTER_SHARE = 0.025, 0.01
# Clamps that are composed at once, and in one piece of more clamps; these numbers affect only the
# computing time.
_FEW_CLAMPS, _PIECE_CLAMPS = 4000, 16


@cache_by_array
def sample_time(time_s: FloatArray, run: IntArray) -> float:
    """Return the median time between samples of a run [s]; 1.0 without a second sample.

    Args:
        time_s: times [s], shape (n,).
        run: run of each sample, shape (n,).
    """
    steps = (time_s[1:] - time_s[:-1])[run[1:] == run[:-1]]
    if not len(steps):
        return 1.0
    middle = len(steps) // 2
    low = middle - 1 + len(steps) % 2
    steps.partition((low, middle))  # faster than numpy's median
    return float(0.5 * (steps[low] + steps[middle]))


def finest_step(time_s: FloatArray, run: IntArray) -> float:
    """Return the 5 % quantile of the time between samples of a run [s]; 1.0 without a second sample.

    Args:
        time_s: times [s], shape (n,).
        run: run of each sample, shape (n,).
    """
    steps = (time_s[1:] - time_s[:-1])[run[1:] == run[:-1]]
    return float(np.quantile(steps, 0.05)) if len(steps) else 1.0


def longest_run(time_s: FloatArray, run: IntArray) -> float:
    """Return the duration of the longest run [s]; 1.0 without a second sample.

    Args:
        time_s: times, increasing within a run, shape (n,) [s].
        run: run of each sample, shape (n,).
    """
    return max(float(time_s[rows.stop - 1] - time_s[rows.start]) for rows in blocks(run)) or 1.0


def apply_per_run(
    operator: Callable[[FloatArray], FloatArray], signal: FloatArray, run: IntArray
) -> FloatArray:
    """Apply an operator to each run's rows of a signal.

    Args:
        operator: function from the rows of a run to as many rows.
        signal: shape (n,) or (n, k).
        run: run of each sample, shape (n,).
    """
    result = np.empty_like(signal, dtype=np.float64)
    for rows in blocks(run):
        result[rows] = operator(np.asarray(signal[rows], dtype=np.float64))
    return result


@cache_by_array
def is_even(time_s: FloatArray, run: IntArray) -> bool:
    """Return whether the sampling rate is constant.

    Args:
        time_s: times [s], shape (n,).
        run: run of each sample, shape (n,).
    """
    step_s = sample_time(time_s, run)
    steps = (time_s[1:] - time_s[:-1])[run[1:] == run[:-1]]
    return bool((np.abs(steps - step_s) <= _UNEVENNESS * step_s).all())


def shift(signal: FloatArray, time_s: FloatArray, run: IntArray, delay_s: float) -> FloatArray:
    """Delay a signal; the first and last values of a run extend beyond its ends.

    A cubic through two samples on each side interpolates without smoothing. Between the first two and the
    last two samples of a run, the interpolation is linear.

    Args:
        signal: signal, shape (n,) or (n, k).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
        delay_s: delay; a positive delay returns earlier values [s].

    Returns:
        Delayed signal in the shape of the signal.
    """
    signal = np.asarray(signal, dtype=np.float64)
    if len(block_index(run)[0]) == len(signal):
        return signal.copy()
    step_s = sample_time(time_s, run)
    if not is_even(time_s, run):
        _, matrix = _interpolation(time_s, run, delay_s, None)
        shifted = np.empty_like(signal)
        for column, result in zip(np.atleast_2d(signal.T), np.atleast_2d(shifted.T), strict=True):
            result[:] = matrix @ column
        return shifted
    newest = int(np.ceil(delay_s / step_s)) - 2  # age of the newest of the four samples
    weights = _even_weights(delay_s / step_s - newest)
    shifted, first = np.empty_like(signal), max(newest + 3, 0)
    count = max(len(signal) + min(newest, 0) - first, 0)
    shifted[first : first + count] = sum(
        weight * signal[first - newest - i :][:count] for i, weight in enumerate(weights)
    )
    near_ends, matrix = _interpolation(time_s, run, delay_s, newest)
    shifted[near_ends] = matrix @ signal
    return shifted


@lru_cache(maxsize=64)
def _even_weights(age: float) -> list[float]:
    """Return the weights of four evenly spaced samples in a cubic's value `age` steps before the newest."""
    weights: list[float] = _cubic_weights(np.arange(4.0)[None, :], np.array([age]))[0].tolist()
    return weights


@cache_by_array  # a search tries many effects before one delay
def _interpolation(
    time_s: FloatArray, run: IntArray, delay_s: float, newest: int | None
) -> tuple[IntArray, "scipy.sparse.csr_array"]:
    """Return rows, and the matrix (rows, n) from a signal to its delayed values, with samples at any times.

    If the age of the newest of four evenly spaced samples is given, only the rows near the ends of runs are
    returned, in which one of the four is outside the run; see `shift`.
    """
    starts, piece = block_index(run)
    rows, ends = np.arange(len(run)), np.append(starts[1:], len(run))[piece]
    if newest is not None:
        rows = rows[(rows - newest - 3 < starts[piece]) | (rows - newest >= ends)]
    # Times [s] (n,) that also increase from run to run, by more than the delay.
    steps = np.diff(time_s, prepend=time_s[:1])
    steps[starts] = 2.0 * abs(delay_s) + 1.0
    clock_s = np.cumsum(steps)
    first, last = starts[piece][rows], ends[rows] - 1
    query_s = np.clip(clock_s[rows] - delay_s, clock_s[first], clock_s[last])
    single = first == last
    after = np.where(single, first, np.clip(np.searchsorted(clock_s, query_s), first + 1, last))
    before = np.where(single, first, after - 1)
    inside = (before - 1 >= first) & (after + 1 <= last)
    part = (clock_s[after] - query_s) / np.where(single, 1.0, clock_s[after] - clock_s[before])
    around = np.stack([before, before, after, after], axis=1)
    around[inside] = after[inside][:, None] + np.arange(-2, 2)
    weights = np.stack([np.zeros(len(part)), part, 1.0 - part, np.zeros(len(part))], axis=1)
    weights[inside] = _cubic_weights(clock_s[around[inside]], query_s[inside])
    edges = np.arange(0, weights.size + 1, 4)
    matrix = scipy.sparse.csr_array((weights.ravel(), around.ravel(), edges), shape=(len(part), len(run)))
    return rows, matrix


def _cubic_weights(times: FloatArray, query: FloatArray) -> FloatArray:
    """Return Lagrange weights (n, 4) of samples at times (n, 4) for a cubic's values at times (n,)."""
    weights = np.ones_like(times)
    for i, j in permutations(range(4), 2):
        weights[:, i] *= (query - times[:, j]) / (times[:, i] - times[:, j])
    return weights


def play(signal: FloatArray, run: IntArray, half_width: float, start: FloatArray | None = None) -> FloatArray:
    """Apply the play (backlash) operator: the state follows the signal after it has crossed a gap.

    Each sample clamps the state to the range signal +- half_width.

    Args:
        signal: signal with independent columns, shape (n,) or (n, k).
        run: run number of each sample, shape (n,).
        half_width: half of the gap, in the unit of the signal.
        start: state at the start of each run, clamped to the gap, shape (runs,) or (runs, k); None for the
            run's first sample.

    Returns:
        State in the shape of the signal.
    """
    if signal.size == 0:
        return signal.astype(np.float64)
    first = [rows.start for rows in blocks(run)]
    low, high = signal - half_width, signal + half_width
    start = signal[first] if start is None else np.clip(start, low[first], high[first])
    low[first] = high[first] = start
    return _apply_clamps(low, high)


def _apply_clamps(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the state (n,) or (n, k) after each of n clamps, starting from the first clamp's lower end.

    Consecutive clamps compose to one clamp. Many clamps are first condensed to one for each piece, and are
    applied within the pieces after the states between them are known.
    """
    if len(low) <= _FEW_CLAMPS:
        low, high, span = low.copy(), high.copy(), 1
        # Each iteration composes over twice as many clamps, until all of them are constant.
        while np.any(low[span:] < high[span:]):
            least, most = low[span:], high[span:]
            low[span:], high[span:] = (
                np.minimum(np.maximum(bound[:-span], least), most) for bound in (low, high)
            )
            span *= 2
        return low
    lows, highs = split_columns(low, _PIECE_CLAMPS), split_columns(high, _PIECE_CLAMPS)
    least, most = lows[0].copy(), highs[0].copy()
    for low_now, high_now in zip(lows[1:], highs[1:], strict=True):
        for bound in (least, most):
            np.minimum(np.maximum(bound, low_now, out=bound), high_now, out=bound)
    state = np.concatenate([low[:1], _apply_clamps(least, most)[:-1]])
    played = np.empty_like(lows)
    for place in range(_PIECE_CLAMPS):
        state = np.minimum(np.maximum(state, lows[place]), highs[place], out=played[place])
    return np.asarray(played.swapaxes(0, 1).reshape(-1, *low.shape[1:])[: len(low)])


@cache_by_array
def smooth_jitter(position: FloatArray, time_s: FloatArray, run: IntArray) -> FloatArray:
    """Smooth a position by a cubic fit, so that encoder jitter does not add to the path length.

    The fit covers 25 ms, or 1 % of the longest run if that is shorter.

    Args:
        position: position, shape (n,).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
    """
    window_s = min(_JITTER_WINDOW_S, _JITTER_SHARE * longest_run(time_s, run))
    window = 2 * int(0.5 * window_s / sample_time(time_s, run)) + 1
    smoothed = np.array(position, dtype=np.float64)
    if 3 < window <= len(position):
        smoothed = _fit_per_run(smoothed, run, window, 0, smoothed)
    smoothed.setflags(write=False)  # the result is cached, and others are cached by it
    return smoothed


def _fit_per_run(signal: FloatArray, run: IntArray, width: int, order: int, short: FloatArray) -> FloatArray:
    """Apply `even_derivative` to each run; runs that are shorter than the window keep the values `short`."""
    result = short.copy()
    for rows in equal_length_blocks(run):
        if rows.shape[1] >= width:
            result[rows] = even_derivative(signal[rows], width, order)
    return result


def direction(
    position: FloatArray, run: IntArray, presliding: float, way: FloatArray | None = None
) -> FloatArray:
    """Compute a direction of motion that reverses gradually over a path and is constant at rest.

    Args:
        position: position, shape (n,).
        run: run number of each sample, shape (n,); the direction is 0 at the start of each run.
        presliding: path after which 1/e of a reversal remains, in the unit of position.
        way: direction that the result approaches, shape (n,); None for the sign of each step.

    Returns:
        Direction in [-1, 1], shape (n,).
    """
    first, _ = block_index(run)
    steps = np.diff(position, prepend=position[:1])
    remaining, state = np.exp(-np.abs(steps) / presliding), np.sign(steps) if way is None else way.copy()
    remaining[first] = state[first] = 0.0
    state *= 1.0 - remaining
    # Each iteration composes s = r s_before + (1 - r) way, r = remaining, over twice as many steps.
    span = 1
    while span < len(state) and np.any(remaining[span:]):
        state[span:] += remaining[span:] * state[:-span]
        remaining[span:] *= remaining[:-span]
        span *= 2
    return state


def running_max(signal: FloatArray, run: IntArray) -> FloatArray:
    """Return the largest value since the start of the run, shape (n,).

    Args:
        signal: signal, shape (n,).
        run: run number of each sample, shape (n,).
    """
    return apply_per_run(np.maximum.accumulate, signal, run)


def derivative(signal: FloatArray, time_s: FloatArray, run: IntArray) -> FloatArray:
    """Differentiate a signal without phase error by fits to five samples; the result is 0 in shorter runs.

    Args:
        signal: signal at a constant sampling rate, shape (n,).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).

    Returns:
        Derivative, shape (n,) [unit of the signal / s].
    """
    return _fit_per_run(signal, run, _WINDOW, 1, np.zeros(len(signal))) / sample_time(time_s, run)


_MAX_LOG = 36.0  # -log(1 - w) at which w equals 1 in double precision
_GRID = 3000


def bouc_wen(
    position: FloatArray, run: IntArray, path: float, sharpness: float, unloading: float
) -> FloatArray:
    """Compute the Bouc-Wen state w, which is 0 at the start of each run.

    Along the direction of motion, dw/dx = (1 - w^n) / path while w moves away from zero, and
    (1 + unloading |w|^n) / path while w returns to zero. n = 1 and unloading = 1 give Dahl's friction.

    Args:
        position: position, shape (n,).
        run: run number of each sample, shape (n,).
        path: path over which w builds up, in the unit of position.
        sharpness: exponent n.
        unloading: 0 for a straight return, 1 for a return that begins twice as steep.

    Returns:
        State in [-1, 1], shape (n,).
    """
    strokes, tables = _divide_strokes(position, run), _bouc_wen_tables(sharpness, unloading)
    from_zero = float(np.interp(0.0, tables.states, tables.paths))
    points, turned, slopes = tables.reached, tables.turned, tables.slopes
    initial, reached = list[float](), 0.0
    for length, is_new in zip((strokes.length / path).tolist(), strokes.is_new_run, strict=True):
        if is_new:
            start = from_zero
        else:  # faster than calling `np.interp` for a scalar
            lower = bisect_right(points, reached) - 1
            start = turned[lower] + slopes[lower] * (reached - points[lower])
        initial.append(start)
        reached = start + length
    states = np.interp(np.array(initial)[strokes.number] + strokes.way / path, tables.paths, tables.states)
    return np.asarray(strokes.sign * states)


@dataclass(frozen=True)
class _Strokes:
    """Motion between reversals."""

    sign: FloatArray  # direction of motion at each sample, 1 or -1, shape (n,)
    number: IntArray  # stroke of each sample, shape (n,)
    way: FloatArray  # path since the start of the stroke, in the unit of position, shape (n,)
    length: FloatArray  # path of each stroke
    is_new_run: list[bool]  # whether a stroke is the first of its run


@cache_by_array
def _divide_strokes(position: FloatArray, run: IntArray) -> _Strokes:
    first, number = block_index(run)
    steps = np.diff(position, prepend=position[:1])
    steps[first] = 0.0
    sign = np.where(steps >= 0.0, 1.0, -1.0)
    starts, stroke = block_index(2 * number + (sign > 0.0))
    way = np.cumsum(np.abs(steps))
    ends = way[np.append(starts[1:], len(steps)) - 1] if len(steps) else way
    way -= np.concatenate([[0.0], ends])[stroke]
    is_new_run = np.append(True, np.diff(run[starts]) != 0)[: len(starts)]
    return _Strokes(sign, stroke, way, np.diff(ends, prepend=0.0), is_new_run.tolist())


@dataclass(frozen=True)
class _BoucWenTables:
    """Tables of Bouc-Wen states over the path, and of the path's value before and after a reversal."""

    states: FloatArray  # states w from -1 to 1
    paths: FloatArray  # path from state -1 to each state
    reached: list[float]  # path from -1 at which the motion reverses
    turned: list[float]  # path from -1 in the new direction, at the same state
    slopes: list[float]  # change of `turned` by `reached` up to the next point; zero from the last one


@lru_cache(maxsize=64)
def _bouc_wen_tables(sharpness: float, unloading: float) -> _BoucWenTables:
    negative = np.linspace(-1.0, 0.0, _GRID // 4)
    positive = -np.expm1(-np.linspace(0.0, _MAX_LOG, _GRID))[1:]
    states = np.unique(np.concatenate([negative, positive]))
    middle = 0.5 * (states[1:] + states[:-1])
    slope = np.where(
        middle < 0.0,
        1.0 + unloading * np.abs(middle) ** sharpness,
        -np.expm1(sharpness * np.log(np.maximum(middle, 1e-300))),
    )
    paths = np.concatenate([[0.0], np.cumsum(np.diff(states) / np.maximum(slope, 1e-16))])
    # Both tables are piecewise linear, so their composition is linear between the points of both.
    reached = np.union1d(paths, np.interp(-states, states, paths))
    turned = np.interp(-np.interp(reached, paths, states), states, paths)
    slopes = np.append(np.diff(turned) / np.diff(reached), 0.0)
    return _BoucWenTables(states, paths, reached.tolist(), turned.tolist(), slopes.tolist())


# Suffixes of a signal's derivatives: the first and the second by position, and that by acceleration.
BY_POSITION, TWICE_BY_POSITION, BY_ACCELERATION = "_by_position", "_twice_by_position", "_by_acceleration"


def shifted_motion(
    data: ChannelData, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> ChannelData:
    """Add changes to the motion of a channel.

    Context signals that depend on the motion, such as a rigid body's torque, change too if the context has
    their derivatives by the channel's position and acceleration. The change with the position is exact for
    the weight of a turning link, which is a sine of its angle, and of second order otherwise.

    Args:
        data: the channel.
        position: change of position, shape (n,), in the unit of position.
        velocity: change of velocity, shape (n,).
        acceleration: change of acceleration, shape (n,).
    """
    context = dict(data.context)
    first, second = position, 0.5 * position**2
    if data.kind.is_angle:
        first, second = np.sin(position), 2.0 * np.sin(0.5 * position) ** 2
    changes = {BY_POSITION: first, TWICE_BY_POSITION: second, BY_ACCELERATION: acceleration}
    for name, values in data.context.items():
        if all(name + suffix in data.context for suffix in changes):
            columns = [-1] + [1] * (values.ndim - 1)
            context[name] = values + sum(
                data.context[name + suffix] * change.reshape(columns) for suffix, change in changes.items()
            )
    return replace(
        data,
        position=data.position + position,
        velocity=data.velocity + velocity,
        acceleration=data.acceleration + acceleration,
        context=context,
    )
