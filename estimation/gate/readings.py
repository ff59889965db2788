"""What is wrong with a sensor's readings by themselves: constant, coarse, or at the end of its range."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.gate.likeness import likeness

_STUCK_SHARE = 0.3  # of the loaded samples at one extreme value: the sensor was at its end
_STILL = 1e-3  # of the range of positions, that a held one stays within
# Free air at a sensor's lower end: how much of it, how far from zero (of all readings' range), how many of
# the readings above are distinct, and how alike neighbouring bends of them are (-0.67 in white noise).
_MOST_OF_AIR, _OFF_ZERO, _FINE, _NOISY = 0.7, 0.01, 0.5, -0.3
# Readings in all, with which a sensor says little, or is coarse. Each edge between two of them tells one
# point of the curve: a straight one, bent by a damper, needs four to be seen to be right or wrong.
# A joint meets each edge in many states of motion, but a single edge gives no scale.
_TOO_FEW_LEVELS, _TOO_FEW_OF_A_JOINT, _FEW_LEVELS = 5, 3, 50
_LOADED = 0.3  # of the largest effort
_FEWEST_BENDS = 100  # by which noise is told


def unchanging(data: ChannelData) -> str | None:
    """Which signal never changes; None if both do."""
    for what, signal in (("effort", data.effort), ("position", data.position)):
        if np.ptp(signal) <= 1e-12 * max(1.0, float(np.max(np.abs(signal)))):
            return f"the {what} never changes; check the sensor and the column"
    return None


def too_coarse(data: ChannelData) -> str | None:
    """Why the readings are too few different ones; None if they are not."""
    levels = len(np.unique(data.effort))
    if levels < (_TOO_FEW_LEVELS if data.kind is ChannelKind.CONTACT else _TOO_FEW_OF_A_JOINT):
        return f"only {levels} different readings: the sensor's steps are too coarse for this effort"
    return None


def at_its_end(data: ChannelData) -> str | None:
    """Where the sensor's range ended before the effort did; None if it did not."""
    if len(np.unique(data.effort)) < _FEW_LEVELS:
        return None  # coarse steps, of which the last is often met
    size = np.abs(data.effort)
    loaded = size > _LOADED * size.max()
    for extreme in (data.effort.max(), data.effort.min()):
        stuck = data.effort == extreme
        share = float(np.mean(stuck[loaded]))
        moves = float(np.ptp(data.position[stuck])) > _STILL * float(np.ptp(data.position))
        if share > _STUCK_SHARE and moves:  # in data without noise, a hold shows one reading too
            return f"{100 * share:.0f} % of the loaded samples show {extreme:.6g}: the sensor is at its end"
    return _stuck_in_air(data)


def _stuck_in_air(data: ChannelData) -> str | None:
    """A lower end that free air lies beyond: one reading there, not zero, and noise as soon as it is left.

    A dead band about zero reads zero; a sensor with coarse steps, and data without noise, may well show one
    reading in free air.
    """
    lowest = float(data.effort.min())
    air, above = data.effort[~data.engaged], data.effort[data.effort > lowest]
    if data.kind is not ChannelKind.CONTACT or data.tare is not None or not len(air):
        return None
    share = float(np.mean(air == lowest))
    off_zero = abs(lowest) > _OFF_ZERO * float(np.ptp(data.effort))
    if share < _MOST_OF_AIR or not off_zero or len(np.unique(above)) < _FINE * len(above):
        return None
    bends = np.diff(data.effort, 2)[data.effort[1:-1] > lowest]
    if len(bends) < _FEWEST_BENDS or likeness(bends[1:], bends[:-1]) > _NOISY:
        return None
    return (
        f"{100 * share:.0f} % of free air shows exactly {lowest:.6g}, and nothing shows less: "
        "the sensor is at its lower end; shift its range, or preload it"
    )
