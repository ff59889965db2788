"""Readings of a motion drawn again: the same true motion, read through the same chain with other errors.

A measured motion is a reading, not the motion. Its errors (steps of an encoder, noise of a tracker) pass
through the derivation of velocity and acceleration, and what a model makes of them looks like a law of the
motion. The only way to know how much of it to expect is to repeat the measurement (R. J. Carroll et al.,
Measurement Error in Nonlinear Models (2006), ch. 3; A. C. Davison, D. V. Hinkley, Bootstrap Methods and their
Application (1997), ch. 4).
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from estimation.channel import ChannelData
from estimation.data.derivatives import HALF_WINDOWS, grid_step, position_error
from estimation.data.local_fit import local_fit
from estimation.signals.blocks import blocks
from estimation.signals.moved import moved
from robot_io.types import FloatArray, IntArray

_PASSED_ON = 0.5  # of the error that a window passes on, that its derivative may differ by
_TRIED = 4000  # samples by which the operator that derived a velocity is recognised
_ALIKE = 1e-6  # of a derivative's mean square, that one derived in another way may differ by


@dataclass(frozen=True)
class Readings:
    """How a channel's motion was read.

    Attributes:
        data: the channel as it was recorded.
        error: of each position, shape (n,): what differs from the smooth motion.
        step: of the grid on which positions lie; 0 where there is none.
        windows: samples to either side from which velocity and acceleration were derived; None for one that
            was measured, or given without noise.
    """

    data: ChannelData
    error: FloatArray
    step: float
    windows: tuple[int | None, int | None]

    @property
    def true_motion(self) -> ChannelData:
        """A channel that moves like the one recorded: its derivatives are exact, its position smooth."""
        still = np.zeros(len(self.error))
        return moved(self.data, -self.error, still, still)

    def draw(self, rng: np.random.Generator) -> ChannelData:
        """That motion read once more: other errors of the position, derived by the same windows."""
        error = self._another_error(rng)
        changes = [error - self.error]
        for order, half in enumerate(self.windows, start=1):
            changes.append(np.zeros(len(error)) if half is None else self._misread(error, half, order))
        return moved(self.data, *changes)

    def _misread(self, error: FloatArray, half: int, order: int) -> FloatArray:
        """What a window makes of noise, and how it bends what it derives, shape (n,)."""
        exact = (self.data.velocity, self.data.acceleration)[order - 1]
        bent = derived(self.data, _integrated(exact, self.data, order), half, order) - exact
        return bent + derived(self.data, error, half, order)

    def _another_error(self, rng: np.random.Generator) -> FloatArray:
        if self.step > 0.0:
            smooth = self.data.position - self.error
            extra = max(float(np.mean(self.error**2)) - self.step**2 / 12.0, 0.0)
            noisy = smooth + np.sqrt(extra) * rng.standard_normal(len(smooth))
            shift = self.step * rng.random()
            read: FloatArray = np.round((noisy + shift) / self.step) * self.step - shift
            return read - smooth
        return shuffled(self.error, self.data.run, rng)


def readings_of(data: ChannelData) -> Readings:
    """Tell the errors of a channel's positions, and how its derivatives came about."""
    step = data.position_step or grid_step(data.position)
    error = position_error(data.time_s, data.position, data.run, step**2 / 12.0)
    few = data.select(np.arange(min(len(data), _TRIED)))
    windows = tuple(_window(few, error[: len(few)], order) for order in (1, 2))
    return Readings(data, error, step, (windows[0], windows[1]))


def shuffled(noise: FloatArray, run: IntArray, rng: np.random.Generator) -> FloatArray:
    """Noise (n,) like the one given, without its tie to the motion: shifted in time, of either sign."""
    made = np.empty_like(noise)
    for rows in blocks(run):
        made[rows] = np.roll(noise[rows], rng.integers(rows.stop - rows.start)) * rng.choice([-1.0, 1.0])
    return made


def derived(data: ChannelData, signal: FloatArray, half: int, order: int) -> FloatArray:
    """Derivative (n,) of a signal (n,) by the window that derived the channel's own."""
    found = np.empty(len(signal))
    for rows in blocks(data.run):
        centres = np.arange(rows.stop - rows.start)
        found[rows] = local_fit(data.time_s[rows], signal[rows], centres, half).fitted[:, order]
    return found


def _integrated(signal: FloatArray, data: ChannelData, times: int) -> FloatArray:
    """A signal (n,) integrated so many times from the start of each run."""
    whole = signal
    for _ in range(times):
        whole = whole.copy()
        for rows in blocks(data.run):
            whole[rows] = cumulative_trapezoid(whole[rows], data.time_s[rows], initial=0.0)
    return whole


def _window(data: ChannelData, error: FloatArray, order: int) -> int | None:
    """The window that gives the channel's derivative of this order; None where none does."""
    given = (data.velocity, data.acceleration)[order - 1]
    best, least = None, np.inf
    for half in HALF_WINDOWS:
        passed_on = derived(data, error, half, order)
        apart = float(np.mean((derived(data, data.position, half, order) - given) ** 2))
        limit = max(_PASSED_ON * float(np.mean(passed_on**2)), _ALIKE * float(np.mean(given**2)))
        if apart <= limit and apart < least:
            best, least = half, apart
    return best
