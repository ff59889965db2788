"""What is wrong with a sensor's readings by themselves: constant, coarse, at the end of its range, copied."""

from collections.abc import Mapping

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.signals.blocks import rows_of_runs
from estimation.signals.cache_by_array import cache_by_channel_arrays
from robot_io.types import BoolArray, FloatArray, IntArray

_STUCK_SHARE = 0.3  # of the loaded samples at one extreme value: the sensor was at its end
_STILL = 1e-3  # of the range of positions, that a held one stays within
# Free air at a sensor's lower end: how much of it, how far from zero (of all readings' range), and how many
# of the readings above are distinct.
_MOST_OF_AIR, _OFF_ZERO, _FINE = 0.7, 0.01, 0.5
# Readings in all, with which a sensor says little, or is coarse. Each edge between two of them tells one
# point of the curve: a straight one, bent by a damper, needs four to be seen to be right or wrong.
# A joint meets each edge in many states of motion, but a single edge gives no scale.
_TOO_FEW_LEVELS, _TOO_FEW_OF_A_JOINT, _FEW_LEVELS = 5, 3, 50
_LOADED = 0.3  # of the largest effort
# Correlation of two runs' noise: by chance 5 / sqrt(n) at most. Of a copy to which noise was added, half as
# large as its own, 0.9.
_COPY, _EQUAL = 0.8, 1.0 - 1e-9
_SAME_PLACE = 0.05  # of the range of positions, that those of copies may differ by
_FEWEST_TOLD = 40  # samples, whose noise is told from another run's
_FEWEST_BENDS = 100  # by which noise is told from a sensor's lower end
# Share of second differences that turn against the one before: 0.73 in white noise, 0.67 in noise as slow as
# a random walk, and next to none in a formula's curves.
_TURNING = 0.6
_DIGITS = 1e-7  # of the effort: what is smaller are the last digits of the numbers, and no sensor's noise
# Of the reader's steps, that half of the bends exceed: by chance, a reading is then the same in 1 of 3 cases.
# Rounding alone makes bends of 0 or 1.
_STEPS = 2.0


def unchanging(data: ChannelData) -> str | None:
    """Which signal never changes; None if both do.

    Args:
        data: the channel.
    """
    for what, signal in (("effort", data.effort), ("position", data.position)):
        if np.ptp(signal) <= 1e-12 * max(1.0, float(np.max(np.abs(signal)))):
            return f"the {what} never changes; check the sensor and the column"
    return None


def too_coarse(data: ChannelData) -> str | None:
    """Why the readings are too few different ones; None if they are not.

    Args:
        data: the channel.
    """
    levels = len(np.unique(data.effort))
    if levels < (_TOO_FEW_LEVELS if data.kind is ChannelKind.CONTACT else _TOO_FEW_OF_A_JOINT):
        return f"only {levels} different readings: the sensor's steps are too coarse for this effort"
    return None


def saturated(data: ChannelData) -> str | None:
    """Say where the sensor's range ended before the effort did; None if it did not.

    Args:
        data: the channel.
    """
    if len(np.unique(data.effort)) < _FEW_LEVELS:
        return None  # coarse steps, of which the last is often met
    size = np.abs(data.effort)
    loaded = size > _LOADED * size.max()
    for extreme in (data.effort.max(), data.effort.min()):
        stuck = data.effort == extreme
        share = float(np.mean(stuck[loaded]))
        moves = float(np.ptp(data.position[stuck])) > _STILL * float(np.ptp(data.position))
        if share > _STUCK_SHARE and moves:  # in data without noise, a hold shows one reading too
            unit = data.kind.effort_unit
            return (
                f"{100 * share:.0f} % of the loaded samples show {extreme:.6g} {unit}: the sensor is at its "
                "end, and what lies beyond is unknown; repeat with less load or a larger range"
            )
    return None


def at_lower_end(data: ChannelData) -> BoolArray:
    """Select readings of a contact at the lower end of the sensor's range, which free air lies beyond.

    One reading there, not zero, and noise as soon as it is left. A dead band about zero reads zero; a sensor
    with coarse steps, and data without noise, may well show one reading in free air.

    Args:
        data: the channel.

    Returns:
        Mask of shape (n,).
    """
    none = np.zeros(len(data), dtype=np.bool_)
    if data.kind is not ChannelKind.CONTACT or data.tare is not None or data.engaged.all():
        return none
    lowest = float(data.effort.min())
    stuck = np.asarray(data.effort == lowest)
    above = data.effort[~stuck]
    off_zero = abs(lowest) > _OFF_ZERO * float(np.ptp(data.effort))
    few_stuck = np.mean(stuck[~data.engaged]) < _MOST_OF_AIR
    if few_stuck or not off_zero or len(np.unique(above)) < _FINE * len(above):
        return none
    bends = np.diff(data.effort, 2)[~stuck[1:-1]]
    return stuck if len(bends) >= _FEWEST_BENDS and _turn_like_noise(bends) else none


def stuck_in_air(data: ChannelData) -> str | None:
    """Say that free air lies beyond the sensor's lower end; None if it does not.

    Args:
        data: the channel.
    """
    stuck = at_lower_end(data)
    if not stuck.any():
        return None
    return (
        f"{100 * np.mean(stuck[~data.engaged]):.0f} % of free air shows exactly {data.effort.min():.6g} "
        f"{data.kind.effort_unit}, and nothing shows less: the sensor is at its lower end, and such samples "
        "are left out; shift its range, or preload it"
    )


@cache_by_channel_arrays("position", "effort", "run")
def copied_runs(data: ChannelData) -> dict[int, tuple[int, float]]:
    """Find runs that are copies of others, number for number or but for less than their noise.

    Held out, a copy tells nothing that is not known already, and fitted it makes intervals too narrow. Times
    may differ. No sensor with noise reads the same twice over a whole run: second differences of two runs are
    uncorrelated where they are noise. What was made without noise may repeat itself, and so may a joint at
    rest whose reader is coarse.

    Args:
        data: the channel.

    Returns:
        For each copy the run that it is a copy of, and the correlation of their noise, 1 for equal numbers.
    """
    range_of_all = float(np.ptp(data.position)) if len(data) else 0.0
    of_length: dict[int, list[IntArray]] = {}
    for rows in rows_of_runs(data.run):
        if np.ptp(data.position[rows]) > _STILL * range_of_all and _is_noisy(data.effort[rows]):
            of_length.setdefault(len(rows), []).append(rows)
    copies: dict[int, tuple[int, float]] = {}
    for length, runs in of_length.items():
        bends = np.diff(data.effort[np.array(runs)], 2)
        bends /= np.linalg.norm(bends, axis=1, keepdims=True)
        least = _COPY if length >= _FEWEST_TOLD else _EQUAL
        for number, rows in enumerate(runs):
            likeness = bends[:number] @ bends[number]
            for first in np.flatnonzero(likeness > least):
                apart = np.max(np.abs(data.position[rows] - data.position[runs[first]]))
                if apart < _SAME_PLACE * range_of_all:
                    copies[int(data.run[rows[0]])] = int(data.run[runs[first][0]]), float(likeness[first])
                    break
    return copies


def copied(copies: Mapping[int, tuple[int, float]]) -> str:
    """Say which runs are left out as copies; see `copied_runs`.

    Args:
        copies: for each copy the run that it is a copy of, and the correlation of their noise.
    """
    (run, (first, likeness)), more = next(iter(copies.items())), len(copies) - 1
    others = f" (and {more} more)" if more else ""
    return (
        f"run {run} is a copy of run {first}{others}: {100.0 * likeness:.0f} % of its noise is the same, so "
        "that it says nothing of its own and is left out; record it again"
    )


def _is_noisy(effort: FloatArray) -> bool:
    """Whether a run's readings (n,) are so noisy that they hardly come out the same twice."""
    bends = np.diff(effort, 2)
    steps = np.diff(np.unique(effort))
    if len(bends) < 2 or len(steps) == 0:
        return False
    usual = float(np.median(np.abs(bends)))
    if usual < _STEPS * steps.min() or usual < _DIGITS * float(np.sqrt(np.mean(effort**2))):
        return False
    return _turn_like_noise(bends)


def _turn_like_noise(bends: FloatArray) -> bool:
    """Whether second differences (n,) change sign from one to the next as those of noise do."""
    return bool(np.mean(bends[1:] * bends[:-1] < 0.0) > _TURNING)
