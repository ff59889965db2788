"""Exponential and power-law memory of signals, within a run or across runs."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from palpate.estimation.signals.blocks import block_index, runs_by_time
from palpate.estimation.signals.cache_by_array import cache_by_array
from palpate.estimation.signals.runwise import is_even, sample_time
from palpate.robot_io.types import FloatArray, IntArray

_LENGTH = 32  # samples of a piece whose memory is computed by one matrix product
_LADDER = 1.4  # ratio of neighboring rates; a sum of five rates over three decades has an error below 1e-3
_SLOWEST, _FASTEST = 1e-2, 10.0  # end rates, relative to the total duration and to the shortest step
_LAGS = np.arange(_LENGTH)[None, :] - np.arange(_LENGTH)[:, None]


def relax(signal: FloatArray, time_s: FloatArray, run: IntArray, tau_s: float) -> FloatArray:
    """Relax a strain with one time constant: z' = signal' - z / tau; see `fading_memory`.

    Args:
        signal: shape (n,) or (n, k).
        time_s: times [s], shape (n,).
        run: run of each sample, shape (n,).
        tau_s: time constant [s].

    Returns:
        z, shape as the signal.
    """
    return fading_memory(signal, time_s, run, np.array([1.0 / tau_s]), np.ones(1))


def low_pass(
    signal: FloatArray, time_s: FloatArray, run: IntArray, tau_s: float, *, from_rest: bool = False
) -> FloatArray:
    """Apply a first-order lag, exact for a signal that is linear between samples.

    Args:
        signal: shape (n,) or (n, k).
        time_s: times [s].
        run: run of each sample.
        tau_s: time constant [s].
        from_rest: start from zero; else from the run's first sample.
    """
    starts, piece = block_index(run)
    deviation = signal if from_rest else signal - signal[starts][piece]
    rate = np.array([1.0 / max(tau_s, 1e-300)])
    return signal - fading_memory(deviation, time_s, run, rate, np.ones(1), alone=True)


def fading_memory(
    signal: FloatArray,
    time_s: FloatArray,
    run: IntArray,
    rates: FloatArray,
    weights: FloatArray,
    *,
    alone: bool = False,
) -> FloatArray:
    """Sum relaxing strains over several rates: z' = signal' - rate z from z = 0, times the rate's weight.

    The result is exact for strains that are linear between samples at any times, and that rise from zero to
    the first sample of a run within one usual step. Between runs the strain is zero, and memory that has not
    faded carries over. Runs that overlap in time count as recorded independently.

    Args:
        signal: strains, shape (n,) or (n, k).
        time_s: times [s].
        run: run of each sample.
        rates: shape (r,), above zero [1/s].
        weights: weights of each rate, shape (r,).
        alone: take each run as recorded independently, whatever its times.

    Returns:
        Shape as the signal.
    """
    if signal.size == 0:
        return signal.astype(np.float64)
    runs = _runs(time_s, run)
    if alone:
        runs = replace(runs, pause_s=np.full(len(runs.start), np.inf))
    strain = signal.reshape(len(signal), -1).T
    step_s = sample_time(time_s, run)
    if is_even(time_s, run):
        return _even_memory(strain, runs, step_s, rates, weights).T.reshape(signal.shape)
    steps_s = np.diff(time_s, prepend=time_s[:1])
    steps_s[runs.start] = step_s
    # Memory of strains (k, n) at any steps (n,) [s], the first of each run the usual one; see `_even_memory`.
    later, wait_s, change = runs.start[1:], steps_s.copy(), _changes(strain, runs)
    wait_s[runs.start[:1]], wait_s[later] = np.inf, runs.pause_s[:-1]
    memory, rows = np.zeros(strain.shape), runs.rows if np.any(np.diff(runs.start) < 0) else slice(None)
    for rate, weight in zip(rates.tolist(), weights.tolist(), strict=True):
        over, added = np.exp(-wait_s * rate), _remaining_share(steps_s * rate) * change
        added[:, later] -= over[later] * strain[:, runs.end[:-1]]
        memory[:, rows] += weight * linear_recursion(over[rows], added.T[rows]).T
    return memory.T.reshape(signal.shape)


def springpot(signal: FloatArray, time_s: FloatArray, run: IntArray, alpha: float) -> FloatArray:
    """Apply a springpot: every step of a signal fades as (t / 1 s)^-alpha.

    t^-alpha is the sum of exponentials at all rates u with weights u^(alpha-1) / gamma(alpha). Those slower
    than the data are a spring, those faster than its samples a dashpot, and the others a ladder of them, each
    exact between samples at any times (trapezoidal rule over log u).

    Args:
        signal: shape (n,) or (n, k).
        time_s: times [s], shape (n,).
        run: run of each sample, shape (n,).
        alpha: exponent, above 0 and below 1.

    Returns:
        Shape as the signal.
    """
    steps = np.diff(time_s, prepend=time_s[:1])
    steps[block_index(run)[0]] = np.inf
    shortest = float(steps.min(initial=np.inf))
    if not 0.0 < shortest < np.inf:
        return np.zeros(signal.shape)
    lowest, highest = np.log(_SLOWEST / np.ptp(time_s)), np.log(_FASTEST / shortest)
    rates = np.exp(np.arange(lowest, highest + _LADDER, _LADDER))
    weights = _LADDER * rates**alpha / scipy.special.gamma(alpha)
    slower = weights[0] / np.expm1(alpha * _LADDER)
    faster = weights[-1] / rates[-1] / np.expm1((1.0 - alpha) * _LADDER)
    slopes = np.diff(signal, axis=0, prepend=signal[:1]) / steps.reshape(-1, *([1] * (signal.ndim - 1)))
    return np.asarray(slower * signal + faster * slopes + fading_memory(signal, time_s, run, rates, weights))


@dataclass(frozen=True)
class _Runs:
    """Runs in order of time, and where their samples lie in pieces of equal length."""

    rows: IntArray  # all samples in that order, shape (n,)
    start: IntArray  # first sample of each run, shape (r,)
    end: IntArray  # last sample of each run
    pause_s: FloatArray  # time from its last sample to the next run [s]; infinite if that is independent
    place: IntArray  # of each sample among those of all pieces, of which a run's last may not be full, (n,)
    last: IntArray  # last piece of each run
    filled: IntArray  # samples in it


@cache_by_array
def _runs(time_s: FloatArray, run: IntArray) -> _Runs:
    parts = runs_by_time(time_s, run)
    start, stop = np.array([(part.start, part.stop) for part in parts]).T
    pause_s = np.append(time_s[start[1:]] - time_s[stop[:-1] - 1], np.inf)
    pieces = np.cumsum(-(-(stop - start) // _LENGTH))
    rows = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    offset = np.append(0, pieces[:-1]) * _LENGTH - start
    place = np.empty(len(run), dtype=np.int64)
    place[rows] = rows + np.repeat(offset, stop - start)
    pause_s[pause_s < 0.0] = np.inf
    return _Runs(rows, start, stop - 1, pause_s, place, pieces - 1, (stop - start - 1) % _LENGTH + 1)


def _changes(strain: FloatArray, runs: _Runs) -> FloatArray:
    """Change of strains (k, n) since the previous sample; at a run's first sample, since zero."""
    change = np.empty(strain.shape)
    np.subtract(strain[:, 1:], strain[:, :-1], out=change[:, 1:])
    change[:, runs.start] = strain[:, runs.start]
    return change


def _remaining_share(ratio: FloatArray) -> FloatArray:
    """Return the share of a step's change that remains at its end, for a step in time constants."""
    return np.asarray(-np.expm1(-ratio) / ratio)


def _even_memory(
    strain: FloatArray, runs: _Runs, step_s: float, rates: FloatArray, weights: FloatArray
) -> FloatArray:
    """Compute the memory of evenly sampled strains (k, n); see `fading_memory`.

    Within a piece of samples, the memory of its own changes is one product of matrices for all rates. The
    memory of earlier pieces is added, which passes from piece to piece for each rate separately.
    """
    powers, remaining = (
        np.exp(-step_s * np.outer(rates, np.arange(_LENGTH))),
        _remaining_share(step_s * rates),
    )
    count, last, columns = runs.last[-1] + 1, runs.last, len(strain)
    padded = np.zeros((columns, count * _LENGTH))
    padded[:, runs.place] = _changes(strain, runs)
    new = padded.reshape(-1, _LENGTH)
    gained = (new @ (powers[:, ::-1] * remaining[:, None]).T).reshape(columns, count, -1)
    lags = runs.filled[:, None] - 1 - np.arange(_LENGTH)
    ways = np.where(lags >= 0, powers[:, lags], 0.0) * remaining[:, None, None]
    of_last = new.reshape(columns, count, -1)[:, last]
    gained[:, last] = np.einsum("kql,rql->kqr", of_last, ways) - strain[:, runs.end, None]
    wait_s = np.full(count, step_s)  # to the first sample of the next piece
    wait_s[last] = runs.pause_s
    after = np.exp(-np.outer(wait_s, rates))
    over = after * powers[:, -1]
    over[last] = after[last] * powers[:, runs.filled - 1].T
    # memory of the pieces before at the first sample of each, and its rest in all others
    initial = np.zeros((columns, count, len(rates)))
    passed = (gained * after).swapaxes(0, 1)[:-1]
    for number in range(len(rates)):
        initial[:, 1:, number] = linear_recursion(over[:-1, number], passed[:, :, number]).T
    memory = new @ np.where(_LAGS >= 0, ((weights * remaining) @ powers)[_LAGS], 0.0)
    memory += initial.reshape(-1, len(rates)) @ (weights[:, None] * powers)
    return memory.reshape(columns, -1).take(runs.place, axis=1)


def linear_recursion(decay: FloatArray, added: FloatArray) -> FloatArray:
    """Solve y[i] = decay[i] y[i-1] + added[i] from zero: a banded triangular system.

    Args:
        decay: shape (n,).
        added: shape (n,) or (n, k).

    Returns:
        y, shape as `added`.
    """
    if not added.size:
        return added
    bands = np.zeros((2, len(decay)), order="F")
    bands[1, :-1] = -decay[1:]
    solution, _ = scipy.linalg.lapack.dtbtrs(bands, added, uplo="L", diag="U")
    return np.asarray(solution.reshape(added.shape))
