"""Machines that count compression negative, in way and force alike."""

import numpy as np

from estimation.statistics.likeness import likeness
from robot_io.types import FloatArray

_FAR = 3.0  # times as far to the one side as to the other
_LIKE = 0.5  # correlation of a way and its force


def counted_negative(way: FloatArray, force: FloatArray) -> bool:
    """Whether displacement (n,) and force (n,) of a contact both go the negative way where it is pressed."""
    for values in (way, force):
        low, high = np.quantile(values, [0.005, 0.995])
        if not -low > _FAR * max(high, 0.0) or low == high:
            return False
    return likeness(way, force) > _LIKE
