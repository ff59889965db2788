"""Exponential and power-law relaxation of signals, within a run or across runs."""

from dataclasses import dataclass

import numpy as np
import scipy

from palpate.estimation.signals.blocks import block_index, runs_by_time
from palpate.estimation.signals.cache_by_array import cache_by_array
from palpate.estimation.signals.runwise import is_even, sample_time
from palpate.robot_io.types import FloatArray, IntArray

_PIECE_LENGTH = 32  # samples of a piece whose relaxation is computed by one matrix product
_LOG_RATE_STEP = 1.4  # difference of log u between adjacent rates; the sum over rates errs by about 1e-3
_SLOWEST, _FASTEST = 1e-2, 10.0  # end rates, relative to 1 / total duration and 1 / shortest step
_LAGS = np.arange(_PIECE_LENGTH)[None, :] - np.arange(_PIECE_LENGTH)[:, None]


def relax(
    signal: FloatArray, time_s: FloatArray, run: IntArray, tau_s: float, *, independent_runs: bool = False
) -> FloatArray:
    """Relax a strain with one time constant: z' = signal' - z / tau; see `fading_memory`.

    Args:
        signal: strain, shape (n,) or (n, k).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
        tau_s: time constant [s].
        independent_runs: whether to treat all runs as recorded independently.

    Returns:
        State z in the shape of the signal.
    """
    rates, weights = np.array([1.0 / tau_s]), np.ones(1)
    return fading_memory(signal, time_s, run, rates, weights, independent_runs=independent_runs)


def low_pass(signal: FloatArray, time_s: FloatArray, run: IntArray, tau_s: float) -> FloatArray:
    """Apply a first-order lag to each run from its first sample, exact for signals linear between samples.

    Args:
        signal: signal, shape (n,) or (n, k).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
        tau_s: time constant [s].
    """
    starts, piece = block_index(run)
    deviation = signal - signal[starts][piece]
    rate = np.array([1.0 / max(tau_s, 1e-300)])
    return signal - fading_memory(deviation, time_s, run, rate, np.ones(1), independent_runs=True)


def fading_memory(
    signal: FloatArray,
    time_s: FloatArray,
    run: IntArray,
    rates: FloatArray,
    weights: FloatArray,
    *,
    independent_runs: bool = False,
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
        independent_runs: whether to treat all runs as recorded independently.

    Returns:
        Weighted sum in the shape of the signal.
    """
    if signal.size == 0:
        return signal.astype(np.float64)
    if is_even(time_s, run):
        runs, strain = _runs(time_s, run, independent_runs), signal.reshape(len(signal), -1).T
        step_s = sample_time(time_s, run)
        return _even_memory(strain, runs, step_s, rates, weights).T.reshape(signal.shape)
    states = _uneven_states(signal, time_s, run, tuple(rates.tolist()), independent_runs)
    return np.asarray(np.tensordot(weights, states, 1).T.reshape(signal.shape))


@cache_by_array  # a search tries many weights of the same rates
def _uneven_states(
    signal: FloatArray, time_s: FloatArray, run: IntArray, rates: tuple[float, ...], independent_runs: bool
) -> FloatArray:
    """Relax strains (n, k) with uneven steps at each rate, (r, k, n); a run's first step is the usual one."""
    runs, strain = _runs(time_s, run, independent_runs), signal.reshape(len(signal), -1).T
    (steps_s, number), change = _different_steps(time_s, run), _changes(strain, runs)
    before_s, later = np.roll(runs.pause_s, 1), runs.first_row[1:]
    states = np.empty((len(rates), *strain.shape))
    rows = runs.rows if np.any(np.diff(runs.first_row) < 0) else slice(None)
    for state, rate in zip(states, rates, strict=True):
        decay, added = np.exp(-steps_s * rate)[number], _remaining_share(steps_s * rate)[number] * change
        decay[runs.first_row] = np.exp(-before_s * rate)
        added[:, later] -= decay[later] * strain[:, runs.last_row[:-1]]
        state[:, rows] = _linear_recursion(decay[rows], added.T[rows]).T
    return states


@cache_by_array
def _different_steps(time_s: FloatArray, run: IntArray) -> tuple[FloatArray, IntArray]:
    """Return the different steps (s,) [s] and each sample's number; the usual step begins a run."""
    steps_s = np.diff(time_s, prepend=time_s[:1])
    steps_s[block_index(run)[0]] = sample_time(time_s, run)
    return np.unique(steps_s, return_inverse=True)


def springpot(
    signal: FloatArray, time_s: FloatArray, run: IntArray, alpha: float, *, independent_runs: bool = False
) -> FloatArray:
    """Apply a springpot: each step of a signal relaxes as (t / 1 s)^-alpha.

    t^-alpha is an integral of exponentials over all rates u with weights u^(alpha-1) / gamma(alpha). Rates
    far below 1 / duration act as a spring, rates far above 1 / step as a dashpot. The rates between them are
    integrated by the trapezoidal rule over log u, each exactly between samples at any times.

    Args:
        signal: signal, shape (n,) or (n, k).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
        alpha: exponent between 0 and 1.
        independent_runs: whether to treat all runs as recorded independently.

    Returns:
        Relaxed signal in the shape of the signal.
    """
    steps = np.diff(time_s, prepend=time_s[:1])
    steps[block_index(run)[0]] = np.inf
    shortest = float(steps.min(initial=np.inf))
    if not 0.0 < shortest < np.inf:
        return np.zeros(signal.shape)
    lowest, highest = np.log(_SLOWEST / np.ptp(time_s)), np.log(_FASTEST / shortest)
    rates = np.exp(np.arange(lowest, highest + _LOG_RATE_STEP, _LOG_RATE_STEP))
    weights = _LOG_RATE_STEP * rates**alpha / scipy.special.gamma(alpha)
    spring = weights[0] / np.expm1(alpha * _LOG_RATE_STEP)
    dashpot = weights[-1] / rates[-1] / np.expm1((1.0 - alpha) * _LOG_RATE_STEP)
    slopes = np.diff(signal, axis=0, prepend=signal[:1]) / steps.reshape(-1, *([1] * (signal.ndim - 1)))
    fading = fading_memory(signal, time_s, run, rates, weights, independent_runs=independent_runs)
    return np.asarray(spring * signal + dashpot * slopes + fading)


@dataclass(frozen=True)
class _Runs:
    """Runs in order of time, with the positions of their samples in pieces of equal length."""

    rows: IntArray  # all samples in order of time, shape (n,)
    first_row: IntArray  # first sample of each run, shape (r,)
    last_row: IntArray  # last sample of each run, shape (r,)
    pause_s: FloatArray  # time from a run's end to the next run, shape (r,) [s]; infinite if independent
    padded_index: IntArray  # row of each sample after each run is padded to whole pieces, shape (n,)
    last_piece: IntArray  # last piece of each run, shape (r,)
    last_length: IntArray  # number of samples in the last piece of each run, shape (r,)


@cache_by_array
def _runs(time_s: FloatArray, run: IntArray, independent_runs: bool) -> _Runs:
    parts = runs_by_time(time_s, run)
    start, stop = np.array([(part.start, part.stop) for part in parts]).T
    pause_s = np.append(time_s[start[1:]] - time_s[stop[:-1] - 1], np.inf)
    pieces, filled = np.cumsum(-(-(stop - start) // _PIECE_LENGTH)), (stop - start - 1) % _PIECE_LENGTH + 1
    rows = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    offset = np.append(0, pieces[:-1]) * _PIECE_LENGTH - start
    padded_index = np.empty(len(run), dtype=np.int64)
    padded_index[rows] = rows + np.repeat(offset, stop - start)
    pause_s[(pause_s < 0.0) | independent_runs] = np.inf
    return _Runs(rows, start, stop - 1, pause_s, padded_index, pieces - 1, filled)


def _changes(strain: FloatArray, runs: _Runs) -> FloatArray:
    """Return the change of strains (k, n) since the previous sample; at a run's start, since zero."""
    change = np.empty(strain.shape)
    np.subtract(strain[:, 1:], strain[:, :-1], out=change[:, 1:])
    change[:, runs.first_row] = strain[:, runs.first_row]
    return change


def _remaining_share(ratio: FloatArray) -> FloatArray:
    """Return the share of a linear change that remains at its end, for the ratio of step to time constant."""
    return np.asarray(-np.expm1(-ratio) / ratio)


def _even_memory(
    strain: FloatArray, runs: _Runs, step_s: float, rates: FloatArray, weights: FloatArray
) -> FloatArray:
    """Relax evenly sampled strains (k, n) by matrix products within pieces, and by recursion between them."""
    powers = np.exp(-step_s * np.outer(rates, np.arange(_PIECE_LENGTH)))
    remaining = _remaining_share(step_s * rates)
    pieces, last_pieces, k = runs.last_piece[-1] + 1, runs.last_piece, len(strain)
    padded = np.zeros((k, pieces * _PIECE_LENGTH))
    padded[:, runs.padded_index] = _changes(strain, runs)
    changes = padded.reshape(-1, _PIECE_LENGTH)
    response = (changes @ (powers[:, ::-1] * remaining[:, None]).T).reshape(k, pieces, -1)
    lags = runs.last_length[:, None] - 1 - np.arange(_PIECE_LENGTH)
    kernels = np.where(lags >= 0, powers[:, lags], 0.0) * remaining[:, None, None]
    last_changes = changes.reshape(k, pieces, -1)[:, last_pieces]
    ends = np.einsum("kql,rql->kqr", last_changes, kernels)
    response[:, last_pieces] = ends - strain[:, runs.last_row, None]
    wait_s = np.full(pieces, step_s)  # time to the first sample of the next piece
    wait_s[last_pieces] = runs.pause_s
    pause_decay = np.exp(-np.outer(wait_s, rates))
    decay = pause_decay * powers[:, -1]
    decay[last_pieces] = pause_decay[last_pieces] * powers[:, runs.last_length - 1].T
    # State from earlier pieces at the first sample of each piece; it then decays within the piece.
    initial = np.zeros((k, pieces, len(rates)))
    inflow = (response * pause_decay).swapaxes(0, 1)[:-1]
    for rate_index in range(len(rates)):
        initial[:, 1:, rate_index] = _linear_recursion(decay[:-1, rate_index], inflow[:, :, rate_index]).T
    memory = changes @ np.where(_LAGS >= 0, ((weights * remaining) @ powers)[_LAGS], 0.0)
    memory += initial.reshape(-1, len(rates)) @ (weights[:, None] * powers)
    return memory.reshape(k, -1).take(runs.padded_index, axis=1)


def _linear_recursion(decay: FloatArray, added: FloatArray) -> FloatArray:
    """Solve y[i] = decay[i] y[i-1] + added[i], (n,) or (n, k), y[-1] = 0, as a banded triangular system."""
    if not added.size:
        return added
    bands = np.zeros((2, len(decay)), order="F")
    bands[1, :-1] = -decay[1:]
    solution, _ = scipy.linalg.lapack.dtbtrs(bands, added, uplo="L", diag="U")
    return np.asarray(solution.reshape(added.shape))
