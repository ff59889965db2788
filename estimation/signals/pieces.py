"""Stretches of samples over which the motion is smooth."""

import numpy as np

from robot_io.types import FloatArray, IntArray

_GAP = 3.5  # median steps that are a gap: jitter, and a sample or two that were lost, are none


def number_pieces(time_s: FloatArray, run: IntArray) -> IntArray:
    """Numbers, from 0, of the stretches that end with a run or at a gap in time, shape (n,).

    A touch ends none. It bends the velocity but does not break it, and a window across it is less wrong than
    the lopsided windows at the ends of two pieces would be (see docs/estimation.md).

    Args:
        time_s: shape (n,) [s].
        run: shape (n,), one block of samples for each run.
    """
    steps_s, same_run = np.diff(time_s), np.diff(run) == 0
    border = ~same_run
    if same_run.any():
        border = border | (steps_s > _GAP * np.median(steps_s[same_run]))
    return np.concatenate([[0], np.cumsum(border)]).astype(np.int64)
