"""Least squares on many random subsets at once."""

from dataclasses import dataclass

import numpy as np

from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, IntArray

_DEGENERATE = 1e-12  # least ratio of the smallest to the largest eigenvalue of a subset's scaled X'X


@dataclass(frozen=True)
class SubsetSolutions:
    """Solutions of the subsets that determine the gains."""

    gains: FloatArray  # shape (trials - skipped, p)
    skipped: int  # how many subsets were degenerate


def solve_subsets(
    columns: FloatArray, effort: FloatArray, size: int, trials: int, rng: np.random.Generator
) -> SubsetSolutions:
    """Solve random subsets of samples by least squares.

    Args:
        columns: shape (n, p).
        effort: shape (n,).
        size: samples in a subset, at least p and at most n.
        trials: number of subsets.
        rng: draws them.

    Raises:
        InputError: the size does not fit, or every subset is degenerate.
    """
    samples, gains = columns.shape
    if not gains <= size <= samples:
        raise InputError(
            f"subsets of {size} samples: must be between {gains} (parameters) and {samples} (samples)"
        )
    lengths = np.sqrt(np.mean(columns**2, axis=0))
    lengths[lengths == 0.0] = 1.0
    picked = _draw(samples, size, trials, rng)
    subset = columns[picked] / lengths
    gram = np.einsum("tsi,tsj->tij", subset, subset)
    eigenvalues = np.linalg.eigvalsh(gram)
    sound = eigenvalues[:, 0] > _DEGENERATE * np.maximum(eigenvalues[:, -1], np.finfo(float).tiny)
    if not sound.any():
        raise InputError(
            f"none of {trials} random subsets determines the parameters: the motion excites too little"
        )
    moment = np.einsum("tsi,ts->ti", subset, effort[picked])
    solved = np.linalg.solve(gram[sound], moment[sound][..., None])[..., 0]
    return SubsetSolutions(solved / lengths, int(np.count_nonzero(~sound)))


def _draw(samples: int, size: int, trials: int, rng: np.random.Generator) -> IntArray:
    """Random subsets without repeats, shape (trials, size); subsets with a repeat are drawn again."""
    if size * size > samples:  # most subsets would have repeats: rank random numbers instead
        return np.argpartition(rng.random((trials, samples)), size - 1, axis=1)[:, :size]
    picked = rng.integers(samples, size=(trials, size))
    while True:
        ordered = np.sort(picked, axis=1)
        repeated = (np.diff(ordered, axis=1) == 0).any(axis=1)
        if not repeated.any():
            return picked
        picked[repeated] = rng.integers(samples, size=(np.count_nonzero(repeated), size))
