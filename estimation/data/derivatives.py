"""Compute velocity and acceleration from positions, without phase error.

A cubic is fitted to the samples around each sample, see `local_fits`. Each piece of the motion is fitted
separately, so that smoothing does not extend across runs.

Each derivative has its own window, since noise and curvature affect the derivatives differently. Wider
windows change the velocity if the present window is too narrow for the noise, or too wide for the motion. The
pilot window is the one at which the velocity changes least (in the manner of O. V. Lepskii, Theory Probab.
Appl. 35 (1991)). Cross-validation would follow correlated errors of neighboring samples, such as those of
encoder steps (J. D. Hart, JRSS B 53 (1991)). The pilot window gives an estimate of the noise, which is at
least the quantization error of the positions. An unbiased risk estimate then gives the errors of velocity and
acceleration for wider windows (J. Fan, I. Gijbels, Local Polynomial Modelling and Its Applications (1996),
ch. 4).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from math import factorial

import numpy as np
import scipy
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from palpate.estimation.channel import ChannelData
from palpate.estimation.signals.blocks import blocks, since_start
from palpate.estimation.signals.cache_by_array import cache_by_channel_arrays
from palpate.estimation.signals.local_polynomials import DEGREE, even_derivative, fit_weights
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

HALF_WINDOWS = (2, 3, 4, 5, 7, 10, 14, 20, 28, 40, 56, 80)
_TOLERANCE = 1.1  # a wider, smoother window is preferred if its error is at most 10 % larger
_RISEN = 1.25  # ratio to the least change so far above which windows bias the motion
_HELD = 20  # samples on each side within which a joint that is held alternates between two readings
_MIN_MOVING = 100  # least number of other samples on which windows are compared
_TRIALS = 4000  # samples on which windows are compared
_ON_GRID = 0.01  # largest distance from a grid point, in steps
_ARITHMETIC = 1e4  # floating-point spacings; smaller changes of position are floating-point errors
_STAIRCASE = 0.8  # least share of the slowest positions that repeat a neighbor's, as with encoder steps
_SLOWEST, _REACH = 0.1, 10  # share of the slowest samples; samples on each side that determine the speed
_BLOCK = 20_000  # samples whose steps are checked together for evenness
_IN_MEMORY = 200_000  # samples whose fits are in memory together
_AT_ONCE = 1024  # windows fitted at once, so that they stay in the processor's cache


@dataclass(frozen=True)
class Motion:
    """Smoothed position with its derivatives."""

    position: FloatArray  # position smoothed by the window of the velocity, shape (n,)
    velocity: FloatArray  # shape (n,) [unit of the position / s]
    acceleration: FloatArray  # shape (n,) [unit of the position / s^2]
    # Number of samples on each side in the fits of velocity and of acceleration.
    half_windows: tuple[int, int]


def differentiate(
    time_s: FloatArray,
    position: FloatArray,
    piece: IntArray,
    half_window: int | tuple[int, int] | None = None,
    *,
    rounding: float | None = None,
    prefer_wide: bool = True,
    window_rows: BoolArray | None = None,
) -> Motion:
    """Estimate velocity and acceleration of a sampled position.

    Args:
        time_s: times, strictly increasing within a piece, shape (n,) [s].
        position: positions, shape (n,).
        piece: number of the smooth motion that each sample belongs to, in one block each, shape (n,).
        half_window: number of samples on each side, or these numbers for velocity and for acceleration; None
            to select them.
        rounding: variance of the positions' quantization; None to estimate it.
        prefer_wide: of the acceleration windows with about equal error, select the widest; False for the
            narrowest, which leaves more noise and less bias, as averages need.
        window_rows: mask of the samples on which windows are compared, shape (n,); None for all.
    """
    if rounding is None:
        rounding = rounding_variance(time_s, position, piece, grid_step(position))
    pieces = list(blocks(piece))
    measured, position = position, since_start(position, piece)
    if half_window is None:
        rows = slice(None) if window_rows is None else np.flatnonzero(window_rows)
        half_window = _select_windows(
            time_s[rows], position[rows], piece[rows], rounding, prefer_wide=prefer_wide
        )
    halves = (half_window, half_window) if isinstance(half_window, int) else half_window
    parts = [
        (rows, first, min(first + _BLOCK, rows.stop))
        for rows in pieces
        for first in range(rows.start, rows.stop, _BLOCK)
    ]
    smooth, slope, curvature = measured - position, *np.empty((2, len(position)))
    for _, group in groupby(parts, lambda part: part[1] // _IN_MEMORY):
        together = list(group)
        chosen = slice(together[0][1], together[-1][2])
        for half in set(halves):
            around, centers = [], []
            for rows, first, last in together:
                start = max(min(first - half, rows.stop - 2 * half - 1), rows.start)
                around.append(slice(start, min(max(last + half, start + 2 * half + 1), rows.stop)))
                centers.append(np.arange(first, last) - start)
            fitted = _fits_by_piece(time_s, position, around, centers, half).fitted
            if half == halves[0]:
                smooth[chosen] += fitted[:, 0]
                slope[chosen] = fitted[:, 1]
            if half == halves[1]:
                curvature[chosen] = fitted[:, 2]
    return Motion(smooth, slope, curvature, halves)


def _select_windows(
    time_s: FloatArray, position: FloatArray, piece: IntArray, rounding: float, *, prefer_wide: bool
) -> tuple[int, int]:
    """Return the half windows of velocity and acceleration of nearly least error; see `differentiate`."""
    smallest = HALF_WINDOWS[0]
    long_enough = [rows for rows in blocks(piece) if rows.stop - rows.start > 2 * smallest + 1]
    if not long_enough:
        return smallest, smallest
    trials = _fit_windows(time_s, position, long_enough, rounding)
    pilot, best = _pilot_window(trials), []
    candidates = [trial for trial in trials if trial.half >= pilot.half]
    for order in (1, 2):
        risks = [trial.risk(pilot, order) for trial in candidates]
        limit = _TOLERANCE**2 * max(0.0, min(risks))
        best.append([c.half for c, risk in zip(candidates, risks, strict=True) if risk <= limit])
    return max(best[0]), max(best[1]) if prefer_wide else min(best[1])


def grid_step(position: FloatArray) -> float:
    """Return the quantization step of the positions, such as an encoder step; 0 without quantization.

    The step matters because at about one step per sample, quantization errors change so slowly that any
    narrow window follows them.

    Args:
        position: measured positions, shape (n,).
    """
    moves = np.abs(np.diff(position))
    moves = moves[moves > _ARITHMETIC * np.spacing(np.abs(position).max(initial=0.0))]
    if not len(moves):
        return 0.0
    in_steps = moves / moves.min()
    return float(moves.min()) if np.abs(in_steps - np.round(in_steps)).max() < _ON_GRID else 0.0


def rounding_variance(time_s: FloatArray, position: FloatArray, piece: IntArray, step: float) -> float:
    """Estimate the variance of the positions' quantization error.

    The tip of an arm has no single step: each encoder makes steps of its own size. The estimate assumes that
    halfway in time between two different readings, the tip is about halfway between them.

    Args:
        time_s: times, shape (n,) [s].
        position: positions, shape (n,).
        piece: number of the smooth motion that each sample belongs to, shape (n,).
        step: quantization step of the positions; 0 if there is none.
    """
    same = (np.diff(position) == 0.0) & (np.diff(piece) == 0)
    waits = np.append(False, same) | np.append(same, False)
    # Select the samples with the slowest nonzero motion, (n,): quantized readings repeat there.
    ahead = np.append(position[_REACH:], np.full(_REACH, position[-1]))[: len(position)]
    behind = np.append(np.full(_REACH, position[0]), position[:-_REACH])[: len(position)]
    way = np.abs(ahead - behind)
    moves = way > 0.0
    limit = float(np.quantile(way[moves], _SLOWEST)) if moves.any() else 0.0
    slow = np.asarray(moves & (way <= limit))
    if step > 0.0 or not slow.any() or np.mean(waits[slow]) < _STAIRCASE:
        return step**2 / 12.0
    error = np.zeros(len(position))
    for rows in blocks(piece):
        x, t = position[rows], time_s[rows]
        before = np.flatnonzero(np.diff(x))
        if len(before):
            middle_t, middle_x = (0.5 * (signal[before] + signal[before + 1]) for signal in (t, x))
            error[rows] = x - np.interp(t, middle_t, middle_x)
    return float(np.mean(error[waits] ** 2))


def position_error(
    time_s: FloatArray, position: FloatArray, run: IntArray, rounding: float
) -> tuple[FloatArray, int]:
    """Estimate the reading error of each position, (n,), and the half window of the smooth motion.

    Errors that are slower than the half window count as motion.

    The smooth motion is a fit with the pilot window. Each residual is divided by the square root of one minus
    its leverage, since the fit follows part of the error.

    Args:
        time_s: times, strictly increasing within a run, shape (n,) [s].
        position: positions, shape (n,).
        run: run number of each sample, shape (n,).
        rounding: variance of the positions' quantization; 0 if there is none.
    """
    pieces = [rows for rows in blocks(run) if rows.stop - rows.start > 2 * HALF_WINDOWS[0] + 1]
    error = np.zeros(len(position))
    if not pieces:
        return error, HALF_WINDOWS[0]
    moved = since_start(position, run)  # so that the velocity at rest is exactly zero
    half = _pilot_window(_fit_windows(time_s, moved, pieces, rounding)).half
    chosen = np.concatenate([np.arange(rows.start, rows.stop) for rows in pieces])
    fits = local_fits(time_s, moved, pieces, [np.arange(rows.stop - rows.start) for rows in pieces], half)
    free = np.sqrt(np.maximum(1.0 - fits.variance[:, 0], 1e-2))
    error[chosen] = (moved[chosen] - fits.fitted[:, 0]) / free
    return error, half


@dataclass(frozen=True)
class _WindowFit:
    """Fits with one window at n samples."""

    half: int  # number of samples on each side
    rounding: float  # variance of the positions' quantization
    residual: FloatArray  # measured minus fitted position, shape (n,)
    fitted: FloatArray  # see `LocalFit`
    variance: FloatArray  # see `LocalFit`

    @property
    def noise(self) -> float:
        """Variance of the positions' noise, if the window has no bias."""
        unleveraged = np.maximum(1 - self.variance[:, 0], 1e-3)
        return max(float(np.mean(self.residual**2 / unleveraged)), self.rounding)

    def risk(self, pilot: "_WindowFit", order: int) -> float:
        """Estimate the mean squared error of a derivative, unbiased if the pilot's residual is only noise.

            risk = mean((f - f_pilot)^2) + noise mean(2 variance - variance_pilot)

        A fit is the best linear estimate in its window. Its covariance with the fit of a narrower window is
        therefore its own variance, and the variance of their difference is the difference of the variances
        (C. L. Mallows, Some Comments on C_p, Technometrics 15 (1973), for a derivative).

        Args:
            pilot: fit with a window that is at most as wide; its residual states the noise.
            order: order of the derivative, 1 for the velocity and 2 for the acceleration.
        """
        squared_difference = np.mean((self.fitted[:, order] - pilot.fitted[:, order]) ** 2)
        variance = np.mean(2 * self.variance[:, order] - pilot.variance[:, order])
        return float(squared_difference + pilot.noise * variance)


def wider_window(half: int, by: int) -> int:
    """Return the window that is `by` steps wider in `HALF_WINDOWS`, at most the widest.

    Args:
        half: number of samples on each side, one of `HALF_WINDOWS`.
        by: number of steps in `HALF_WINDOWS`.
    """
    return HALF_WINDOWS[min(HALF_WINDOWS.index(half) + by, len(HALF_WINDOWS) - 1)]


def _fit_windows(
    time_s: FloatArray, position: FloatArray, pieces: list[slice], rounding: float
) -> list[_WindowFit]:
    """Fit with all windows that are shorter than the longest piece, the narrowest first."""
    longest = max(rows.stop - rows.start for rows in pieces)
    halves = [half for half in HALF_WINDOWS if 2 * half + 1 < longest or half == HALF_WINDOWS[0]]
    stride = max(1, sum(rows.stop - rows.start for rows in pieces) // _TRIALS)
    centers = [np.arange(0, rows.stop - rows.start, stride) for rows in pieces]
    held = [_alternates(position[rows], rounding) for rows in pieces]
    moving = [chosen[~still[chosen]] for chosen, still in zip(centers, held, strict=True)]
    centers = moving if sum(map(len, moving)) >= _MIN_MOVING else centers
    measured = np.concatenate([position[rows][chosen] for rows, chosen in zip(pieces, centers, strict=True)])
    trials = []
    for half in halves:
        fit = local_fits(time_s, position, pieces, centers, half)
        trials.append(_WindowFit(half, rounding, measured - fit.fitted[:, 0], fit.fitted, fit.variance))
    return trials


def _alternates(position: FloatArray, rounding: float) -> BoolArray:
    """Return the samples around which a joint that is held alternates between two readings, shape (n,).

    These readings say nothing on the motion, but windows shorter than their period follow them.

    Args:
        position: positions of one piece, shape (n,).
        rounding: variance of the positions' quantization; 0 if there is none.
    """
    step, size = np.sqrt(12.0 * rounding), 2 * _HELD + 1
    ranges = maximum_filter1d(position, size) - minimum_filter1d(position, size)
    path = size * uniform_filter1d(np.abs(np.diff(position, append=position[-1])), size)
    return np.asarray((np.abs(ranges - step) < 0.5 * step) & (path > 1.5 * step))


def _pilot_window(trials: list[_WindowFit]) -> _WindowFit:
    """Return the window before the pair of windows between which the velocity changes least.

    The search stops at the first minimum, since windows that are far too wide agree again. It continues while
    the residual does not exceed the quantization error, since such windows follow the steps.
    """
    velocity = [trial.fitted[:, 1] for trial in trials]
    changes = [float(np.mean((wider - narrow) ** 2)) for narrow, wider in pairwise(velocity)]
    least = 0
    for number, change in enumerate(changes):
        if change < changes[least]:
            least = number
        elif change > _RISEN**2 * changes[least] and trials[number].noise > trials[number].rounding:
            break
    return trials[max(least - 1, 0)]


_EVEN = 1e-4  # relative difference of time steps below which they count as even


@dataclass(frozen=True)
class LocalFit:
    """Local polynomial fits around n samples."""

    fitted: FloatArray  # position, velocity and acceleration, shape (n, 3)
    # Their variances for noise of variance 1, shape (n, 3); the variance of a position is also its leverage.
    variance: FloatArray


def local_fits(
    time_s: FloatArray, position: FloatArray, pieces: Sequence[slice], centers: Sequence[IntArray], half: int
) -> LocalFit:
    """Fit a polynomial around samples of several pieces.

    Args:
        time_s: times, strictly increasing within a piece, shape (n,) [s].
        position: positions, shape (n,).
        pieces: rows of each smooth motion.
        centers: for each piece, indices of the samples relative to its start.
        half: number of samples on each side.
    """
    width, ends = 2 * half + 1, np.array([(rows.start, rows.stop) for rows in pieces])
    steps = np.diff(np.concatenate([time_s[rows] for rows in pieces]))
    steps = np.delete(steps, np.cumsum(ends[:-1, 1] - ends[:-1, 0]) - 1)  # without steps between pieces
    if np.ptp(steps) <= _EVEN * steps.max() and (ends[:, 1] - ends[:, 0]).min() >= width:
        first, last = np.repeat(ends, [len(chosen) for chosen in centers], axis=0).T
        around = first + np.concatenate(centers)
        starts = np.clip(around - half, first, last - width)
        return _even_fit(float(np.mean(steps)), position, around, starts, width)
    return _fits_by_piece(time_s, position, pieces, centers, half)


def _fits_by_piece(
    time_s: FloatArray, position: FloatArray, pieces: Sequence[slice], centers: Sequence[IntArray], half: int
) -> LocalFit:
    """Fit pieces with different or uneven time steps; see `local_fits`."""
    counts = [len(chosen) for chosen in centers]
    last = np.cumsum(counts)
    fitted, variance = np.zeros((2, last[-1], 3))
    uneven, units_s = np.zeros(last[-1], dtype=np.bool_), np.zeros(len(pieces))
    for number, (rows, chosen) in enumerate(zip(pieces, centers, strict=True)):
        times, chosen_rows = time_s[rows], slice(last[number] - counts[number], last[number])
        steps, width = times[1:] - times[:-1], min(2 * half + 1, len(times))
        if len(steps) and steps.max() - steps.min() > _EVEN * steps.max():
            uneven[chosen_rows], units_s[number] = True, width / 2 * float(times[-1] - times[0]) / len(steps)
            continue
        starts = np.clip(chosen - half, 0, len(times) - width)
        fit = _even_fit(float(np.mean(steps)) if len(steps) else 1.0, position[rows], chosen, starts, width)
        fitted[chosen_rows], variance[chosen_rows] = fit.fitted, fit.variance
    first, length = np.repeat([(rows.start, rows.stop - rows.start) for rows in pieces], counts, axis=0).T
    unit_s, place = np.repeat(units_s, counts), np.concatenate(centers)
    widths = np.minimum(2 * half + 1, length)
    for width in np.unique(widths[uneven]).tolist():
        same_width = np.flatnonzero(uneven & (widths == width))
        for batch in np.split(same_width, np.arange(_AT_ONCE, len(same_width), _AT_ONCE)):
            starts = first[batch] + np.clip(place[batch] - half, 0, length[batch] - width)
            rows_of_windows, centers_of_windows = starts[:, None] + np.arange(width), (first + place)[batch]
            powers, inverse = _uneven_fits(time_s, rows_of_windows, centers_of_windows, unit_s[batch])
            away = position[rows_of_windows] - position[centers_of_windows, None]
            coefficients = (inverse @ (powers @ away[..., None]))[:, :3, 0]
            per_second = np.array([1.0, 1.0, 2.0]) / unit_s[batch, None] ** np.arange(3)
            terms = coefficients.shape[1]
            fitted[batch, :terms] = coefficients * per_second[:, :terms]
            fitted[batch, 0] += position[centers_of_windows]
            variance[batch, :terms] = np.einsum("nii->ni", inverse)[:, :3] * per_second[:, :terms] ** 2
    return LocalFit(fitted, variance)


def _uneven_fits(
    time_s: FloatArray, rows: IntArray, centers: IntArray, unit_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the powers of time (n, terms, width) in windows (n, width), and inverses of their products."""
    scaled_time = (time_s[rows] - time_s[centers, None]) / unit_s[:, None]
    powers = np.ones((len(rows), min(DEGREE, rows.shape[1] - 1) + 1, rows.shape[1]))
    for power in range(1, powers.shape[1]):
        np.multiply(powers[:, power - 1], scaled_time, out=powers[:, power])
    return powers, _inverse(powers @ powers.swapaxes(1, 2))


def local_derivative(time_s: FloatArray, signal: FloatArray, half: int, order: int) -> FloatArray:
    """Differentiate pieces of a signal by local fits around all samples, in the shape of the signal.

    Args:
        time_s: times, strictly increasing in a piece, shape (n,) or (pieces, n) [s].
        signal: signal in the shape of the times.
        half: number of samples on each side.
        order: order of the derivative, 0 to 2.
    """
    length, steps = signal.shape[-1], np.diff(time_s)
    longest, shortest = steps.max(axis=-1, initial=0.0), steps.min(axis=-1, initial=np.inf)
    if np.any(longest - shortest > _EVEN * longest):
        pieces = [slice(first, first + length) for first in range(0, signal.size, length)]
        centers = [np.arange(length)] * len(pieces)
        fits = _fits_by_piece(time_s.ravel(), signal.ravel(), pieces, centers, half)
        return fits.fitted[:, order].reshape(signal.shape)
    step_s = steps.mean(axis=-1, keepdims=True) if length > 1 else 1.0
    return even_derivative(signal, min(2 * half + 1, length), order) / step_s**order


def uneven_derivative_operator(
    time_s: FloatArray, pieces: Sequence[slice], half: int, order: int
) -> "scipy.sparse.csr_array":
    """Return the matrix (n, n) that applies `local_derivative` to each piece of a signal.

    Args:
        time_s: times with any steps, shape (n,) [s].
        pieces: consecutive rows of each smooth motion, which together contain all samples.
        half: number of samples on each side in a fit.
        order: order of the derivative, 0 to 2.
    """
    count = len(time_s)
    first = np.array([rows.start for rows in pieces])
    lengths = np.diff(first, append=count)
    spans_s = time_s[first + lengths - 1] - time_s[first]
    widths = np.minimum(2 * half + 1, lengths)
    ends = np.append(0, np.cumsum(np.repeat(widths, lengths)))
    weights, columns = np.zeros(ends[-1]), np.zeros(ends[-1], dtype=np.int64)
    piece = np.repeat(np.arange(len(pieces)), lengths)
    for width in np.unique(widths).tolist():
        at = np.flatnonzero(widths[piece] == width)
        start, length = first[piece[at]], lengths[piece[at]]
        rows = (start + np.clip(at - start - half, 0, length - width))[:, None] + np.arange(width)
        unit_s = width / 2 * spans_s[piece[at]] / np.maximum(length - 1, 1)
        unit_s[unit_s == 0.0] = 1.0
        places = ends[at][:, None] + np.arange(width)
        columns[places] = rows
        powers, inverse = _uneven_fits(time_s, rows, at, unit_s)
        if order < len(inverse[0]):
            derived = (inverse[:, order, None] @ powers)[:, 0]
            weights[places] = derived * factorial(order) / unit_s[:, None] ** order
    return scipy.sparse.csr_array((weights, columns, ends), shape=(count, count))


def _even_fit(
    step_s: float, position: FloatArray, centers: IntArray, starts: IntArray, width: int
) -> LocalFit:
    """Fit windows with even steps: common weights in the middle, and special weights near the ends."""
    place, fitted, variance = centers - starts, *np.empty((2, len(centers), 3))
    ends = np.flatnonzero(place != width // 2)
    windows = position[starts[ends, None] + np.arange(width)]
    for order in range(3):
        weights = fit_weights(width, order) / step_s**order
        fitted[:, order] = np.correlate(position, weights[width // 2])[starts]
        fitted[ends, order] = np.einsum("nw,nw->n", weights[place[ends]], windows)
        variance[:, order] = np.sum(weights**2, axis=1)[place]
    return LocalFit(fitted, variance)


def _inverse(matrix: FloatArray) -> FloatArray:
    """Invert symmetric matrices (n, k, k); use pseudo-inverses if repeated times make one singular."""
    try:
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrix, hermitian=True), dtype=np.float64)


@cache_by_channel_arrays("time_s", "position", "run", "position_step")
def reading_error(data: ChannelData) -> FloatArray:
    """Estimate the reading error of each position of a channel, shape (n,); see `position_error`.

    Args:
        data: the channel with the measured positions.
    """
    step = data.position_step or grid_step(data.position)
    rounding = rounding_variance(data.time_s, data.position, data.run, step)
    return position_error(data.time_s, data.position, data.run, rounding)[0]
