"""Periodic parts of a signal: harmonics over position, and spectral lines over time."""

from math import gcd

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.signals.arm_signals import TORQUE
from palpate.estimation.signals.blocks import block_index, blocks, number_pieces
from palpate.estimation.signals.cache_by_array import cache_by_channel_arrays
from palpate.robot_io.types import FloatArray, IntArray

_MIN_PERIODS = 3.0  # least number of periods in the longest piece
_MAX_FREQUENCY = 0.4  # largest number of periods per step
_FINENESS = 10  # grid frequencies per resolvable frequency
_MIN_STEPS, _MAX_STEPS = 10, 16384  # steps in a piece; longer pieces are split to limit memory
_MIN_LENGTH = 0.1  # least length of a piece, relative to the longest one
_NEIGHBORS = 20 * _FINENESS  # number of frequencies on each side with which a peak is compared
_Piece = tuple[FloatArray, FloatArray]  # number of samples at each step, and their sum


def strongest_frequency(
    time_s: FloatArray, run: IntArray, signal: FloatArray, step_s: float
) -> tuple[float, float, float] | None:
    """Find the peak of a Lomb-Scargle periodogram with an independent phase in each piece.

    A common phase would cause side peaks, whose spacing decreases with the distance between pieces. The
    samples of each piece are placed on an even grid, so that the sums are fast Fourier transforms.

    Args:
        time_s: times, increasing within a run, shape (n,) [s].
        run: run number of each sample, shape (n,).
        signal: signal, NaN if unknown, shape (n,).
        step_s: time between samples [s].

    Returns:
        The frequency [Hz], its share of the variance within pieces, and the ratio of this share to the median
        share of the frequencies around it; None if all pieces are too short.
    """
    pieces = _pieces(time_s, run, signal, step_s)
    longest = max((len(counts) for counts, _ in pieces), default=0)
    if longest < _MIN_STEPS:
        return None
    pieces = [piece for piece in pieces if len(piece[0]) >= _MIN_LENGTH * longest]
    size = 1 << int(np.ceil(np.log2(_FINENESS * longest)))
    number = np.arange(int(np.ceil(_MIN_PERIODS * size / longest)), int(_MAX_FREQUENCY * size))
    power = sum(float(values @ values) for _, values in pieces)
    if not len(number) or power == 0.0:
        return None
    # Compute the sum of squares explained by a sine of each frequency w. With Y = sum y exp(-i w t) and
    # W = sum exp(-2 i w t) over N samples it is 2 (N |Y|^2 - Re(Y^2 W*)) / (N^2 - |W|^2), see N. R. Lomb,
    # Astrophysics and Space Science 39 (1976).
    explained = np.zeros(len(number))
    for counts, values in pieces:
        count = float(counts.sum())
        transform, doubled = np.fft.fft(values, size)[number], np.fft.fft(counts, size)[2 * number]
        power_at = count * np.abs(transform) ** 2 - (transform**2 * doubled.conj()).real
        explained += 2.0 * power_at / np.maximum(count**2 - np.abs(doubled) ** 2, 1e-9 * count**2)
    best = int(np.argmax(explained))
    neighbors = explained[max(best - _NEIGHBORS, 0) : best + _NEIGHBORS + 1]
    share, typical = float(explained[best] / power), float(np.median(neighbors) / power)
    return float(number[best] / (size * step_s)), share, share / max(typical, 1e-300)


def _pieces(time_s: FloatArray, run: IntArray, signal: FloatArray, step_s: float) -> list[_Piece]:
    """Return the pieces without gaps, from the first to the last known sample, on an even time grid."""
    known = np.isfinite(signal)
    pieces: list[_Piece] = []
    for rows in blocks(number_pieces(time_s, run)):
        for first in range(rows.start, rows.stop, _MAX_STEPS):
            known_rows = first + np.flatnonzero(known[first : min(first + _MAX_STEPS, rows.stop)])
            if len(known_rows):
                grid_index = np.rint((time_s[known_rows] - time_s[known_rows[0]]) / step_s).astype(np.int64)
                values = signal[known_rows] - signal[known_rows].mean()
                sums = np.bincount(grid_index, values).astype(np.float64)
                pieces.append((np.bincount(grid_index).astype(np.float64), sums))
    return pieces


_MAX_WAVES = 12  # largest number of tried wave numbers
_MIN_WAVES = 1.5  # least number of waves within the range of motion; a longer wave could be any curve
_MIN_SHARE = 0.02  # least share of the remaining energy that an additional wave must explain
_MAX_CHANGE = 0.8  # largest difference of a wave between halves of the data, relative to its amplitude
_MAX_SAMPLES = 30_000  # longer data are decimated
_BINS = 16384
_BINS_PER_WAVE = 4  # least number of bins per wave
_MIN_SPACING = 1.3  # least difference between wave numbers, in periods within the range
_OVERSAMPLING = 8  # points of the spectrum per independent wave
_NEARLY_ALL = 0.98  # share of all waves' energy in the multiples of one wave number
_WHOLE_TURN = 0.75  # share of a turn above which waves repeat with each turn
_MIN_REPEATS = 2.0  # least number of periods of the pattern within the range; fewer may be a smooth law


@cache_by_channel_arrays("run", "position", "velocity", "acceleration", "effort", TORQUE)
def harmonics(data: ChannelData) -> tuple[float, tuple[int, ...]]:
    """Find the wave number n [1/position] and its multiples (harmonics) in the ripple of an effort.

    The method is orthogonal matching pursuit (Pati et al. 1993). It selects the strongest wave in the
    residual, fits all selected waves jointly with a simple model of the motion, and repeats this while a wave
    explains 2 % of the rest. The joint fit is needed because ripple also accelerates the joint. Waves that
    differ between two halves of the data are skipped. All runs are used to select the waves; only their
    amplitudes are fitted later.

    On an axis that covers about a turn, any whole number of waves per turn is valid, since magnets, teeth and
    bearings have different numbers.

    Args:
        data: the channel.

    Returns:
        The wave number n, and its multiples in ascending order; no multiples without ripple.
    """
    span = float(np.ptp(data.position))
    if span == 0.0:
        return 0.0, ()
    whole_turn = data.kind.is_angle and span > _WHOLE_TURN * 2.0 * np.pi
    data = data.select(np.arange(0, len(data), -(-len(data) // _MAX_SAMPLES)))
    # Columns (n, k) of simple motion and direction, each of length 1.
    q, v = data.position, data.velocity
    parts = [np.ones(len(q)), q, np.sin(q), np.cos(q), v, np.sign(v), data.acceleration]
    parts += [data.context[TORQUE]] if TORQUE in data.context else []  # contains the other joints' motion
    columns = np.column_stack(parts)
    motion = np.asarray(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    waves, tried, sizes = list[float](), list[float](), np.empty(0)
    residual, _ = _fit_waves(data, motion, waves)
    starts, piece = block_index(data.run)  # halves: odd and even runs, or the halves of a single run
    half = piece % 2 if len(starts) > 1 else np.arange(len(residual)) * 2 // len(residual)
    for _ in range(_MAX_WAVES):
        tried.append(_strongest_wave(data.position, residual, span, tried))
        after, energy = _fit_waves(data, motion, [*waves, tried[-1]])
        if np.sum(after**2) > (1.0 - _MIN_SHARE) * np.sum(residual**2):
            break
        wave = np.column_stack([np.sin(tried[-1] * q), np.cos(tried[-1] * q)])
        first, second = (
            np.linalg.lstsq(wave[half == side], residual[half == side], rcond=None)[0] for side in (0, 1)
        )
        if np.linalg.norm(first - second) <= _MAX_CHANGE * 0.5 * np.linalg.norm(first + second):
            waves.append(tried[-1])
            residual, sizes = after, energy
    if whole_turn:
        per_turn = sorted({n for wave in waves if (n := round(wave)) > 0 and abs(wave - n) * span < np.pi})
        shared = gcd(*per_turn) or 1
        return float(shared), tuple(wave // shared for wave in per_turn)
    return _common_wave_number(np.array(waves), sizes, 2.0 * np.pi / span)


def _strongest_wave(position: FloatArray, residual: FloatArray, span: float, known: list[float]) -> float:
    """Return the wave number of the largest peak of the spectrum over position, except known peaks."""
    bins = ((position - position.min()) / span * (_BINS - 1)).astype(np.int64)
    count = np.bincount(bins, minlength=_BINS)
    total = np.bincount(bins, weights=residual, minlength=_BINS)
    mean = np.where(count > 0, total / np.maximum(count, 1), 0.0)
    height = np.abs(np.fft.rfft(mean, _OVERSAMPLING * _BINS))
    waves = np.arange(len(height)) / _OVERSAMPLING * (_BINS - 1) / _BINS  # number of waves within the span
    height[(waves < _MIN_WAVES) | (waves > np.count_nonzero(count) / _BINS_PER_WAVE)] = 0.0
    for wave in known:
        height[np.abs(waves - wave * span / (2.0 * np.pi)) < _MIN_SPACING] = 0.0
    peak = int(np.argmax(height))
    low, middle, high = height[[max(peak - 1, 0), peak, min(peak + 1, len(height) - 1)]]
    curvature = 2.0 * middle - low - high  # of a parabola through the three points
    offset = 0.5 * (high - low) / curvature if low > 0.0 and high > 0.0 and curvature > 0.0 else 0.0
    return float((waves[peak] + offset * waves[1]) * 2.0 * np.pi / span)


def _fit_waves(data: ChannelData, motion: FloatArray, waves: list[float]) -> tuple[FloatArray, FloatArray]:
    """Fit motion and waves jointly to the effort; return the residual (n,) and the energy of each wave."""
    angle = np.multiply.outer(data.position, np.array(waves))
    columns = np.hstack([motion, np.sin(angle), np.cos(angle)])
    gains = np.linalg.lstsq(columns, data.effort, rcond=1e-9)[0]
    energy = np.sum(gains[motion.shape[1] :].reshape(2, len(waves)) ** 2, axis=0)
    return data.effort - columns @ gains, energy


def _common_wave_number(
    waves: FloatArray, energy: FloatArray, resolution: float
) -> tuple[float, tuple[int, ...]]:
    """Return the largest common divisor of nearly all wave numbers, and their multiples of it.

    Waves that are not multiples come from slow changes with position.
    """
    max_divisor = int(waves[0] / (_MIN_REPEATS * resolution)) if len(waves) else 0
    for divisor in range(1, max_divisor + 1):
        multiples = np.round(waves * divisor / waves[0])
        is_multiple = (np.abs(waves - multiples * waves[0] / divisor) < resolution / 5.0) & (multiples > 0)
        if np.sum(energy[is_multiple]) >= _NEARLY_ALL * np.sum(energy):
            return float(waves[0] / divisor), tuple(sorted({int(m) for m in multiples[is_multiple]}))
    return 0.0, ()
