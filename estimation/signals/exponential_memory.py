"""Exponential and power-law relaxation of signals, within a run or across runs."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from palpate.estimation.signals.blocks import block_index, runs_by_time
from palpate.estimation.signals.cache_by_array import cache_by_array
from palpate.estimation.signals.runwise import is_even, sample_time
from palpate.robot_io.types import FloatArray, IntArray

_LENGTH = 32  # samples of a piece whose relaxation is computed by one matrix product
_LADDER = 1.4  # difference of adjacent rates in log u; a sum of five rates over three decades errs by 1e-3
_SLOWEST, _FASTEST = 1e-2, 10.0  # end rates, relative to 1 / total duration and 1 / shortest step
_LAGS = np.arange(_LENGTH)[None, :] - np.arange(_LENGTH)[:, None]


def relax(signal: FloatArray, time_s: FloatArray, run: IntArray, tau_s: float) -> FloatArray:
    """Relax a strain with one time constant: z' = signal' - z / tau; see `fading_memory`.

    Args:
        signal: strain, shape (n,) or (n, k).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
        tau_s: time constant [s].

    Returns:
        State z in the shape of the signal.
    """
    return fading_memory(signal, time_s, run, np.array([1.0 / tau_s]), np.ones(1))


def low_pass(
    signal: FloatArray, time_s: FloatArray, run: IntArray, tau_s: float, *, from_rest: bool = False
) -> FloatArray:
    """Apply a first-order lag, exact for a signal that is linear between samples.

    Args:
        signal: signal, shape (n,) or (n, k).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
        tau_s: time constant [s].
        from_rest: whether each run starts from zero; False to start from its first sample.
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
    """Compute a weighted sum of relaxing strains over several rates: z' = signal' - rate z, initially z = 0.

    The result is exact for strains that are linear between samples at any times, and that rise from zero to
    the first sample of a run within one usual step. Between runs the strain is zero, and the remaining state
    carries over. Runs that overlap in time are treated as recorded independently.

    Args:
        signal: strains, shape (n,) or (n, k).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
        rates: relaxation rates, positive, shape (r,) [1/s].
        weights: weights of the rates, shape (r,).
        alone: whether to treat all runs as recorded independently.

    Returns:
        Weighted sum in the shape of the signal.
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
    # Relax strains (k, n) with uneven steps (n,) [s]; the first step of each run is the usual one.
    later, wait_s, change = runs.start[1:], steps_s.copy(), _changes(strain, runs)
    wait_s[runs.start[:1]], wait_s[later] = np.inf, runs.pause_s[:-1]
    memory, rows = np.zeros(strain.shape), runs.rows if np.any(np.diff(runs.start) < 0) else slice(None)
    for rate, weight in zip(rates.tolist(), weights.tolist(), strict=True):
        over, added = np.exp(-wait_s * rate), _remaining_share(steps_s * rate) * change
        added[:, later] -= over[later] * strain[:, runs.end[:-1]]
        memory[:, rows] += weight * linear_recursion(over[rows], added.T[rows]).T
    return memory.T.reshape(signal.shape)


def springpot(signal: FloatArray, time_s: FloatArray, run: IntArray, alpha: float) -> FloatArray:
    """Apply a springpot: each step of a signal relaxes as (t / 1 s)^-alpha.

    t^-alpha is an integral of exponentials over all rates u with weights u^(alpha-1) / gamma(alpha). Rates
    far below 1 / duration act as a spring, rates far above 1 / step as a dashpot. The rates between them are
    integrated by the trapezoidal rule over log u, each exactly between samples at any times.

    Args:
        signal: signal, shape (n,) or (n, k).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
        alpha: exponent between 0 and 1.

    Returns:
        Relaxed signal in the shape of the signal.
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
    """Runs in order of time, with the positions of their samples in pieces of equal length."""

    rows: IntArray  # all samples in order of time, shape (n,)
    start: IntArray  # first sample of each run, shape (r,)
    end: IntArray  # last sample of each run, shape (r,)
    pause_s: FloatArray  # time from a run's end to the next run, shape (r,) [s]; infinite if independent
    place: IntArray  # position of each sample in the concatenated pieces; a run's last piece is padded, (n,)
    last: IntArray  # last piece of each run, shape (r,)
    filled: IntArray  # number of samples in the last piece of each run, shape (r,)


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
    """Return the change of strains (k, n) since the previous sample; at a run's start, since zero."""
    change = np.empty(strain.shape)
    np.subtract(strain[:, 1:], strain[:, :-1], out=change[:, 1:])
    change[:, runs.start] = strain[:, runs.start]
    return change


def _remaining_share(ratio: FloatArray) -> FloatArray:
    """Return the share of a linear change that remains at its end; `ratio` is step over time constant."""
    return np.asarray(-np.expm1(-ratio) / ratio)


def _even_memory(
    strain: FloatArray, runs: _Runs, step_s: float, rates: FloatArray, weights: FloatArray
) -> FloatArray:
    """Relax evenly sampled strains (k, n); see `fading_memory`.

    Within a piece of samples, one matrix product for all rates gives the response to its own changes. The
    state from earlier pieces is propagated from piece to piece for each rate separately, and then added.
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
    wait_s = np.full(count, step_s)  # time to the first sample of the next piece
    wait_s[last] = runs.pause_s
    after = np.exp(-np.outer(wait_s, rates))
    over = after * powers[:, -1]
    over[last] = after[last] * powers[:, runs.filled - 1].T
    # State from earlier pieces at the first sample of each piece; it then decays within the piece.
    initial = np.zeros((columns, count, len(rates)))
    passed = (gained * after).swapaxes(0, 1)[:-1]
    for number in range(len(rates)):
        initial[:, 1:, number] = linear_recursion(over[:-1, number], passed[:, :, number]).T
    memory = new @ np.where(_LAGS >= 0, ((weights * remaining) @ powers)[_LAGS], 0.0)
    memory += initial.reshape(-1, len(rates)) @ (weights[:, None] * powers)
    return memory.reshape(columns, -1).take(runs.place, axis=1)


def linear_recursion(decay: FloatArray, added: FloatArray) -> FloatArray:
    """Solve y[i] = decay[i] y[i-1] + added[i] with y[-1] = 0 as a banded triangular system.

    Args:
        decay: factors, shape (n,).
        added: inputs, shape (n,) or (n, k).

    Returns:
        Solution y in the shape of `added`.
    """
    if not added.size:
        return added
    bands = np.zeros((2, len(decay)), order="F")
    bands[1, :-1] = -decay[1:]
    solution, _ = scipy.linalg.lapack.dtbtrs(bands, added, uplo="L", diag="U")
    return np.asarray(solution.reshape(added.shape))
