"""Whether motion and effort belong together: in their units, their times, their signs."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.gate.likeness import likeness
from estimation.signals.runwise import per_run, sample_time

_LONGEST_CONTACT_M = 0.2  # deeper indentations than this are a mistaken unit
_STIFFEST_N_M = 1e7
_SOFTEST_N_M = 1e-2
_FASTEST_RAD_S = 300.0
_SAME_SHAPE = 0.7  # correlation, half of the variance: it is this position's velocity, whatever its scale
_OTHER_SCALE = 1.5  # smoothing takes less than a third off a velocity; a mistaken unit is off by ten and more
_LEAST_PRESSED = 0.01  # of the samples
# Standard deviations of free air, that one in twenty pressed samples is above: of noise, 1 in 16 000 is.
_ABOVE_AIR, _ONE_IN_TWENTY = 4.0, 0.95
_TO_SIGMA = 1.4826  # of the median deviation, for normal noise
_SHIFTS_S = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)  # as of clocks that were started by hand
_JOINED, _APART = 0.9, 0.5  # correlations of depth and force: any spring's is above the one
_LEAST_EXPLAINED = 0.1  # share of a force's variance that depth and velocity explain, whatever the object is


def mistaken_units(data: ChannelData) -> str | None:
    """Which unit is hardly the one it is said to be; None if nothing says so."""
    if data.kind is ChannelKind.CONTACT:
        deepest = float(data.position.max())
        if deepest > _LONGEST_CONTACT_M:
            return f"the deepest indentation is {deepest:.3g} m; is the displacement in millimetres?"
        pressed = data.engaged
        if pressed.any():
            slope = float(np.ptp(data.effort)) / max(deepest, 1e-12)
            if not _SOFTEST_N_M < slope < _STIFFEST_N_M:
                return f"force over depth is {slope:.3g} N/m; check the units of both"
    if data.kind is ChannelKind.REVOLUTE and float(np.quantile(np.abs(data.velocity), 0.9)) > _FASTEST_RAD_S:
        return "the joint turns faster than 300 rad/s most of the time; is the angle in degrees?"
    return None


def mistaken_times(data: ChannelData) -> str | None:
    """The velocity must be the position's slope: else times, or units of one of them, are off."""
    step = sample_time(data.time_s, data.run)
    slope = per_run(lambda x: np.gradient(x, step) if len(x) > 1 else 0.0 * x, data.position, data.run)
    energy = float(slope @ slope)
    if energy == 0.0:
        return None
    ratio, alike = float(slope @ data.velocity) / energy, likeness(slope, data.velocity)
    if alike > _SAME_SHAPE and not 1.0 / _OTHER_SCALE < ratio < _OTHER_SCALE:
        return f"the velocity is {ratio:.3g} times the slope of the position; check times and units"
    return None


def misaligned(data: ChannelData) -> str | None:
    """Effort and motion must belong to the same moment: look for a shift that joins them far better."""
    if data.kind is not ChannelKind.CONTACT:
        return None
    pressed = np.where(data.engaged, data.position, 0.0)
    step = sample_time(data.time_s, data.run)
    now = likeness(pressed, data.effort)
    for seconds in _SHIFTS_S:
        shift = round(seconds / step)
        if shift and abs(shift) < len(pressed) // 4:
            then = likeness(np.roll(pressed, shift), data.effort)
            if then > _JOINED and now < _APART:
                return f"the force belongs to the motion of {-seconds:+.1f} s; align their times"
    return None


def no_contact(data: ChannelData) -> str | None:
    """Why nothing was pressed, or not as it is said; None if it was."""
    if data.kind is not ChannelKind.CONTACT:
        return None
    pressed = data.engaged
    if pressed.mean() < _LEAST_PRESSED:
        return "no contact: the displacement is never positive; press the object"
    if not pressed.all():
        air = data.effort[~pressed]
        spread = _TO_SIGMA * float(np.median(np.abs(air - np.median(air))))
        if np.quantile(np.abs(data.effort[pressed] - np.median(air)), _ONE_IN_TWENTY) < _ABOVE_AIR * spread:
            return "no contact: the force while pressed is no more than the noise in free air"
    if likeness(np.where(pressed, data.position, 0.0), data.effort) < 0.0:
        return "force falls with depth; check the sign of force and displacement"
    return _stranger(data)


def _stranger(data: ChannelData) -> str | None:
    """A force that has next to nothing to do with the motion."""
    pressed = data.select(data.engaged)
    motion = np.column_stack([pressed.position, pressed.velocity, np.ones(len(pressed))])
    size = np.linalg.norm(motion, axis=0)
    motion = motion / np.where(size > 0.0, size, 1.0)
    left = pressed.effort - motion @ np.linalg.lstsq(motion, pressed.effort, rcond=1e-9)[0]
    share = 1.0 - float(np.var(left) / np.var(pressed.effort)) if np.ptp(pressed.effort) > 0.0 else 0.0
    if share < _LEAST_EXPLAINED:
        return f"depth and velocity explain {100.0 * share:.0f} % of the force; do they belong together?"
    return None
