"""Stretches of samples over which the motion is smooth."""

import numpy as np

from robot_io.types import BoolArray, FloatArray, IntArray

_GAP = 1.5  # median steps that are a gap


def number_pieces(time_s: FloatArray, run: IntArray, touching: BoolArray | None = None) -> IntArray:
    """Numbers, from 0, of the stretches that end with a run, at a touch or release, or at a gap in time.

    Args:
        time_s: shape (n,) [s].
        run: shape (n,), one block of samples for each run.
        touching: shape (n,), samples in contact; None if it is not known.
    """
    steps_s, same_run = np.diff(time_s), np.diff(run) == 0
    border = ~same_run
    if same_run.any():
        border = border | (steps_s > _GAP * np.median(steps_s[same_run]))
    if touching is not None:
        border = border | (np.diff(touching.astype(np.int8)) != 0)
    return np.concatenate([[0], np.cumsum(border)]).astype(np.int64)
