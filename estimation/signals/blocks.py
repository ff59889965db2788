"""The stretches of samples that belong together."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from robot_io.types import BoolArray, IntArray


def blocks(number: IntArray) -> Iterator[slice]:
    """The rows of each stretch of equal numbers, in their order; none of no rows.

    Args:
        number: of the run or piece that each sample belongs to, shape (n,).
    """
    borders = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
    for start, stop in pairwise(borders):
        if stop > start:
            yield slice(start, stop)


def stretches(mask: BoolArray, number: IntArray) -> IntArray:
    """Numbers, shape (n,), that change wherever the mask or the number of the run changes."""
    changes = (np.diff(mask) != 0) | (np.diff(number) != 0)
    return np.concatenate([[0], np.cumsum(changes)])[: len(mask)]
