"""Which numbers of a stranger's file can be worked with, and what is said of the others."""

import numpy as np
from numpy.typing import NDArray

from robot_io.types import FloatArray

LARGEST = 1e30  # in any unit; squares of what is larger overflow
SMALLEST = 1.0 / LARGEST  # of a signal's largest number; squares of what is smaller are 0
FINEST_S = 1e-12  # from sample to sample, far below any clock's step; what is finer does not increase


def useless_rows(values: FloatArray) -> NDArray[np.int64]:
    """Indices of the rows of an array (n,) or (n, k) with a value that is not finite or too large."""
    usable = np.abs(values) <= LARGEST
    return np.flatnonzero(~(usable if usable.ndim == 1 else usable.all(axis=1)))


def fault_of(number: float) -> str:
    """What is wrong with such a value."""
    return "too large a number" if np.isfinite(number) else "no finite number"


def more_like_it(count: int) -> str:
    """How many faults there are beside the one that is named."""
    return f" ({count - 1} more like it)" if count > 1 else ""
