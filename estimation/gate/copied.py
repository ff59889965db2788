"""Whether runs are copies of each other: held out, a copy tells nothing that is not known already."""

import numpy as np

from estimation.channel import ChannelData
from estimation.signals.blocks import rows_of_runs
from robot_io.types import FloatArray

_STILL = 1e-3  # of the range of positions, that a held one stays within
_DIGITS = 1e-7  # of the effort: what is smaller are the last digits of the numbers, and no sensor's noise
# Of the reader's steps, that half of the bends exceed: by chance, a reading is then the same in 1 of 3 cases.
# Rounding alone makes bends of 0 or 1.
_STEPS = 2.0
# Of the bends, that turn against the one before: 0.73 in white noise, 0.67 in noise as slow as a random walk,
# and next to none in a formula's curves.
_TURNING = 0.6


def copied(data: ChannelData) -> str | None:
    """Which run is another one's copy, number for number; None if none is.

    Times may differ. No sensor with noise reads the same twice over a whole run. What was made without noise
    may, and so may a joint at rest whose reader is coarse.
    """
    range_of_all = float(np.ptp(data.position)) if len(data) else 0.0
    seen: dict[tuple[bytes, bytes], int] = {}
    for rows in rows_of_runs(data.run):
        effort, position = data.effort[rows], data.position[rows]
        if np.ptp(position) <= _STILL * range_of_all or not _is_noisy(effort):
            continue
        run = int(data.run[rows[0]])
        first = seen.setdefault((effort.tobytes(), position.tobytes()), run)
        if first != run:
            return (
                f"run {run} is a copy of run {first}, number for number, and says nothing of its own; leave "
                "it out, or record it again"
            )
    return None


def _is_noisy(effort: FloatArray) -> bool:
    """Whether a run's readings (n,) are so noisy that they hardly come out the same twice."""
    bends = np.diff(effort, 2)
    steps = np.diff(np.unique(effort))
    if len(bends) < 2 or len(steps) == 0:
        return False
    usual = float(np.median(np.abs(bends)))
    if usual < _STEPS * steps.min() or usual < _DIGITS * float(np.sqrt(np.mean(effort**2))):
        return False
    return bool(np.mean(bends[1:] * bends[:-1] < 0.0) > _TURNING)
