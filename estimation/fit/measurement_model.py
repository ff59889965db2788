"""Measurement model of a motion, which simulates the same motion with new reading errors.

Reading errors of the motion (encoder steps, noise of a tracker) pass through the derivation of velocity and
acceleration, and their effect on a prediction resembles a law of the motion. Simulated measurements show the
size of this effect (R. J. Carroll et al., Measurement Error in Nonlinear Models (2006), ch. 3; A. C. Davison,
D. V. Hinkley, Bootstrap Methods and their Application (1997), ch. 4).
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import scipy

from palpate.estimation.channel import ChannelData
from palpate.estimation.data.derivatives import (
    HALF_WINDOWS,
    grid_step,
    local_derivative,
    local_fits,
    position_error,
    rounding_variance,
    uneven_derivative_operator,
    wider_window,
)
from palpate.estimation.signals.blocks import blocks, equal_length_blocks, number_pieces
from palpate.estimation.signals.cache_by_array import IdentityKey, cache_by_array, cache_by_channel_arrays
from palpate.estimation.signals.runwise import is_even, sample_time, shifted_motion
from palpate.robot_io.types import FloatArray, IntArray

_MAX_WEIGHTS = 4_000_000  # largest size of an operator that is kept in memory
_NOISE_SHARE = 0.5  # tolerance on a derivative, relative to the filtered reading error
_MAX_TRIED = 4000  # samples used to recognize the filter that derived a velocity
_FORMULA_TOLERANCE = 1e-6  # relative tolerance on a derivative that another formula computed
_REACH_S = 0.03  # time difference at which positions are compared; encoder noise is negligible there
_MIN_STEPS = 3  # samples
_ROUNDING = 1e-12  # rounding error of a computed position, relative to the range of motion
_MAX_ERROR_SHARE = 0.5  # largest share of the error in the mean square of a resolved acceleration
_pieces = cache_by_array(number_pieces)  # derivatives are computed separately between gaps in time


@dataclass(frozen=True)
class MeasurementModel:
    """How position, velocity, acceleration and effort of a channel were measured."""

    data: ChannelData  # the recorded channel
    error: FloatArray  # position minus smooth motion, shape (n,)
    velocity_error: FloatArray  # the same for a measured velocity; 0 for a derived one
    halves: tuple[int, int]  # half windows [samples] of the smooth motion, for position and velocity
    step: float  # quantization step of the positions; 0 if there is none
    is_staircase: bool  # whether positions show steps without a common grid, from encoders of several joints
    # Half windows of the filters of velocity and acceleration; None for a measured or noise-free signal.
    filters: tuple[int | None, int | None]
    is_of_velocity: bool  # whether the acceleration was derived from the velocity, not from positions
    exact: tuple[FloatArray, ...]  # velocity and acceleration of the smooth motion, shape (n,) each
    bent: tuple[FloatArray, ...]  # the same after the filters, with their smoothing bias

    @property
    def smoothed_motion(self) -> ChannelData:
        """Smoothed motion with exact derivatives, close to the measured motion."""
        velocity, acceleration = self.exact
        data = self.data
        return shifted_motion(data, -self.error, velocity - data.velocity, acceleration - data.acceleration)

    def simulate(self, rng: np.random.Generator, share: float = 1.0) -> ChannelData:
        """Simulate a measurement of the smoothed motion: new position errors, derived by the same filters.

        Args:
            rng: random generator.
            share: factor on all errors.
        """
        error, data = share * self._simulate_error(rng), self.data
        if self.filters[0] is not None:
            noise = _filtered(data, error, self.filters[0], 1)
        else:
            slow = _low_frequency_noise(self.velocity_error, self._pieces, self.halves[1], rng)
            noise = share * (shuffle_noise(self.velocity_error, data.run, rng) + slow)
        velocity, acceleration = self.bent[0] + noise, self.bent[1]
        if self.filters[1] is not None:
            signal, order = (noise, 1) if self.is_of_velocity else (error, 2)
            acceleration = acceleration + _filtered(data, signal, self.filters[1], order)
        return shifted_motion(
            data, error - self.error, velocity - data.velocity, acceleration - data.acceleration
        )

    @property
    def _pieces(self) -> IntArray:
        return np.asarray(_pieces(self.data.time_s, self.data.run))

    def _simulate_error(self, rng: np.random.Generator) -> FloatArray:
        if self.step > 0.0:
            smooth = self.data.position - self.error
            extra = max(float(np.mean(self.error**2)) - self.step**2 / 12.0, 0.0)
            noisy = smooth + np.sqrt(extra) * rng.standard_normal(len(smooth))
            shift = self.step * rng.random()
            error: FloatArray = np.round((noisy + shift) / self.step) * self.step - shift - smooth
            return error - np.mean(error)  # a common error is a shift of zero, not a reading error
        if self.is_staircase:
            # Shift the error as a function of position, since steps repeat in each pass. It is taken from
            # fast passes, because at slow motion the smoothing window follows the steps.
            place, speed = self.data.position - self.error, np.abs(self.data.velocity)
            fast = np.flatnonzero(speed >= np.median(speed))
            fast = fast[np.argsort(place[fast])]
            known, span = place[fast], float(np.ptp(place[fast])) or 1.0
            target = known[0] + (place - known[0] + span * rng.random()) % span
            nearest = np.minimum(np.searchsorted(known, target), len(fast) - 1)
            return np.asarray(self.error[fast][nearest] * rng.choice([-1.0, 1.0]))
        slow = _low_frequency_noise(self.error, self._pieces, self.halves[0], rng)
        return shuffle_noise(self.error, self.data.run, rng) + slow


def identify_measurement_model(data: ChannelData) -> MeasurementModel:
    """Identify errors of a channel's positions, and filters that derived its derivatives; cached by motion.

    Args:
        data: the channel.
    """
    return replace(_identify(data), data=data)


@cache_by_channel_arrays("time_s", "run", "position", "velocity", "acceleration", "position_step")
def _identify(data: ChannelData) -> MeasurementModel:
    step = data.position_step or grid_step(data.position)
    piece = _pieces(data.time_s, data.run)
    rounding = rounding_variance(data.time_s, data.position, piece, step)
    error, half = position_error(data.time_s, data.position, piece, rounding)
    start = data.select(np.arange(min(len(data), _MAX_TRIED)))
    velocity, _ = _identify_window(start, start.position, error, start.velocity, 1)
    velocity_error, velocity_half = np.zeros(len(data)), half
    acceleration, difference = _identify_window(start, start.position, error, start.acceleration, 2)
    if velocity is None:
        velocity_error, velocity_half = position_error(data.time_s, data.velocity, piece, 0.0)
    noise = velocity_error if velocity is None else channel_derivative(data, error, velocity, 1)
    derived, excess = _identify_window(start, start.velocity, noise, start.acceleration, 1)
    is_of_velocity = derived is not None and excess < difference
    acceleration = derived if is_of_velocity else acceleration
    filters = velocity, acceleration
    is_staircase = step == 0.0 < rounding
    halves, orders = (half, velocity_half), (1, 1 if is_of_velocity else 2)
    derivatives = data.velocity - velocity_error, data.acceleration
    exact = tuple(map(partial(_invert_filter, data), derivatives, filters, orders))
    filtered = tuple(map(partial(_apply_filter, data), exact, filters, orders))
    settings = halves, step, is_staircase, filters, is_of_velocity
    return MeasurementModel(data, error, velocity_error, *settings, exact, filtered)


def is_acceleration_resolved(data: ChannelData) -> bool:
    """Return whether errors cause at most half of the mean square of a channel's acceleration.

    Otherwise an inertia cannot be fitted, because its column holds mainly measurement errors.

    Args:
        data: the channel.
    """
    measurement = identify_measurement_model(data)
    simulated = measurement.simulate(np.random.default_rng(0)).acceleration
    rounding = _ROUNDING * data.range_of_motion / sample_time(data.time_s, data.run) ** 2
    error = np.mean((simulated - measurement.bent[1]) ** 2) + rounding**2
    return bool(error <= _MAX_ERROR_SHARE * np.mean(data.acceleration**2))


def shuffle_noise(noise: FloatArray, run: IntArray, rng: np.random.Generator) -> FloatArray:
    """Return noise (n,) of the same spectrum, independent of the motion: shifted in time, random sign.

    Args:
        noise: noise of each sample, shape (n,).
        run: run number of each sample, shape (n,).
        rng: random generator.
    """
    shuffled = np.empty_like(noise)
    for rows in equal_length_blocks(run):
        count = rows.shape[1]
        shift, sign = rng.integers(count, size=(len(rows), 1)), rng.choice([-1.0, 1.0], (len(rows), 1))
        shuffled[rows] = sign * np.take_along_axis(noise[rows], (np.arange(count) - shift) % count, axis=1)
    return shuffled


def _low_frequency_noise(error: FloatArray, run: IntArray, half: int, rng: np.random.Generator) -> FloatArray:
    """Simulate errors (n,) below a smoothing window's cutoff, of the spectral density just above it."""
    # Below the cutoff, reading errors are part of the smooth motion: a cubic fit to 2 h + 1 samples passes
    # half of a wave's amplitude or more (R. W. Schafer, IEEE Signal Processing Magazine 28 (2011)).
    edge = min(0.5 * 4.0 / max(3.2 * half - 4.6, 1.0), 0.25)  # [cycles per sample]
    slow = np.zeros_like(error)
    for rows in equal_length_blocks(run) if error.any() else ():
        count = rows.shape[1]
        spectrum, frequency = np.fft.rfft(error[rows]), np.fft.rfftfreq(count)
        above, below = (frequency >= edge) & (frequency < 2.0 * edge), (frequency > 0.0) & (frequency < edge)
        if not above.any() or not below.any():
            continue
        density = np.mean(np.abs(spectrum[:, above]) ** 2, axis=1, keepdims=True)
        missing = np.maximum(density - np.abs(spectrum[:, below]) ** 2, 0.0)
        parts = rng.standard_normal((2, *missing.shape))
        added = np.zeros_like(spectrum)
        added[:, below] = np.sqrt(0.5 * missing) * (parts[0] + 1j * parts[1])
        slow[rows] = np.fft.irfft(added, count)
    return slow


def channel_derivative(data: ChannelData, signal: FloatArray, window: int, order: int) -> FloatArray:
    """Differentiate a signal with a local polynomial fit on the channel's time grid, shape (n,).

    Args:
        data: the channel.
        signal: signal, shape (n,).
        window: number of samples on each side in a window.
        order: order of the derivative.
    """
    piece = _pieces(data.time_s, data.run)
    if not is_even(data.time_s, piece):
        pieces = list(blocks(piece))
        centers = [np.arange(rows.stop - rows.start) for rows in pieces]
        return local_fits(data.time_s, signal, pieces, centers, window).fitted[:, order]
    derivative = np.empty(len(signal))
    for rows in equal_length_blocks(piece):
        derivative[rows] = local_derivative(data.time_s[rows], signal[rows], window, order)
    return derivative


def _filtered(data: ChannelData, signal: FloatArray, window: int, order: int) -> FloatArray:
    """Return `channel_derivative`, by an operator that is kept for the many signals of one filter."""
    piece = _pieces(data.time_s, data.run)
    if len(signal) * (2 * window + 1) >= _MAX_WEIGHTS or is_even(data.time_s, piece):
        return channel_derivative(data, signal, window, order)
    times = IdentityKey(data.time_s), IdentityKey(piece)
    return np.asarray(_derivative_operator(*times, window, order) @ signal)


@lru_cache(maxsize=8)
def _derivative_operator(
    time_s: IdentityKey, piece: IdentityKey, window: int, order: int
) -> "scipy.sparse.csr_array":
    """Return the derivative operator of a channel with uneven time steps."""
    return uneven_derivative_operator(time_s.wrapped, list(blocks(piece.wrapped)), window, order)


def _apply_filter(data: ChannelData, exact: FloatArray, window: int | None, order: int) -> FloatArray:
    """Apply the smoothing of a differentiation filter to an exact derivative of this order, (n,)."""
    if window is None:
        return exact
    signal = exact
    for _ in range(order):  # integrate over each piece without a gap
        signal = signal.copy()
        for rows in equal_length_blocks(_pieces(data.time_s, data.run)):
            signal[rows] = scipy.integrate.cumulative_simpson(signal[rows], x=data.time_s[rows], initial=0.0)
    return _filtered(data, signal, window, order)


def _invert_filter(data: ChannelData, derivative: FloatArray, window: int | None, order: int) -> FloatArray:
    """Estimate the exact derivative (n,) by adding back the smoothing error (J. W. Tukey's twicing, 1977)."""
    if window is None:
        return derivative
    smooth = channel_derivative(data, derivative, wider_window(window, 1), 0)
    return 2.0 * smooth - _apply_filter(data, smooth, window, order)


def _identify_window(
    data: ChannelData, signal: FloatArray, error: FloatArray, target: FloatArray, order: int
) -> tuple[int | None, float]:
    """Identify the window with which a target (n,) was derived from a signal (n,) with a reading error.

    Returns the half width of the window (None if no window fits) and the median squared difference during
    motion. The median ignores differences at the ends of pieces.
    """
    matches: list[tuple[float, int]] = []
    moving = target != 0.0
    if not moving.any():
        return None, np.inf
    for window in HALF_WINDOWS:
        noise = channel_derivative(data, error[: len(data)], window, order)
        difference = float(np.median((channel_derivative(data, signal, window, order) - target)[moving] ** 2))
        limit = max(_NOISE_SHARE * float(np.median(noise**2)), _FORMULA_TOLERANCE * float(np.mean(target**2)))
        if difference <= limit:
            matches.append((difference, window))
    least, best = min(matches, default=(np.inf, None))
    return best, least


def inflate_acceleration_noise(data: ChannelData) -> ChannelData:
    """Correct the acceleration so that its average over a time agrees with the measured positions.

    The correction is the second difference of the measured positions minus that of the integrated
    acceleration, for even and uneven time steps. Ends of runs are not changed.

    Args:
        data: the channel.
    """
    integrate = scipy.integrate.cumulative_trapezoid
    change = np.zeros(len(data))
    for rows in blocks(_pieces(data.time_s, data.run)):
        time_s = data.time_s[rows]
        if len(time_s) < 2:
            continue
        reach = max(int(_REACH_S / float(np.median(np.diff(time_s))) + 0.5), _MIN_STEPS)
        if len(time_s) <= 2 * reach:
            continue
        velocity = data.velocity[rows.start] + integrate(data.acceleration[rows], time_s, initial=0.0)
        deviation = data.position[rows] - integrate(velocity, time_s, initial=0.0)
        before, middle, after = deviation[: -2 * reach], deviation[reach:-reach], deviation[2 * reach :]
        back = time_s[reach:-reach] - time_s[: -2 * reach]
        ahead = time_s[2 * reach :] - time_s[reach:-reach]
        bend = 2.0 * ((after - middle) / ahead - (middle - before) / back) / (ahead + back)
        change[rows.start + reach : rows.stop - reach] = bend
    zero = np.zeros(len(data))
    return shifted_motion(data, zero, zero, change)


def with_derived_signals(motion: ChannelData, fitted: ChannelData) -> ChannelData:
    """Add the signals that were derived in a fit, such as the load of a joint, to a motion.

    Args:
        motion: smoothed or simulated motion of the channel, without these signals.
        fitted: the channel of the fit.
    """
    return replace(motion, context={**fitted.context, **motion.context})
