"""Steady readings under known forces, cut out of a record."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.signals.blocks import blocks
from robot_io.errors import InputError
from robot_io.types import BoolArray, FloatArray

_SETTLING_SHARE = 0.25  # of a plateau, left out where nothing says when it is settled
_FEWEST = 3  # samples of a plateau
_OUTLIER = 8.0  # robust standard deviations: a converter's glitch, not its noise
_NORMAL = 1.4826  # standard deviation of normal noise over its median absolute deviation


@dataclass(frozen=True)
class Plateaus:
    """Mean readings under known forces, in the order of time; arrays of shape (m,).

    Attributes:
        reference_n: force that was there [N].
        reading: mean of what the sensor showed, in its unit.
        std_err: of each mean if the samples' noise is white, in the sensor's unit.
        direction: 1 where the force was reached from below, -1 from above, 0 at the start.
        glitches: samples that were left out as outliers.
    """

    reference_n: FloatArray
    reading: FloatArray
    std_err: FloatArray
    direction: FloatArray
    glitches: int = 0

    def __len__(self) -> int:
        return len(self.reading)


def find_plateaus(reading: FloatArray, reference_n: FloatArray, settled: BoolArray | None = None) -> Plateaus:
    """Cut a record where the reference changes, and take the mean of each piece.

    Args:
        reading: shape (n,), in the sensor's unit.
        reference_n: shape (n,), known force [N]; constant on a plateau.
        settled: shape (n,), which samples count; None leaves out the first quarter of each plateau.

    Raises:
        InputError: fewer than three samples are left of every plateau.
    """
    steps = np.concatenate([[0], np.cumsum(np.diff(reference_n) != 0.0)])
    pieces = [_settled(reading[rows], None if settled is None else settled[rows]) for rows in blocks(steps)]
    references = [float(reference_n[rows][0]) for rows in blocks(steps)]
    long_enough = [number for number, piece in enumerate(pieces) if len(piece) >= _FEWEST]
    if not long_enough:
        raise InputError(
            f"no plateau has {_FEWEST} settled samples: the reference must stay constant for a while"
        )
    return plateaus_of([references[i] for i in long_enough], [pieces[i] for i in long_enough])


def plateaus_of(references_n: Sequence[float], pieces: Sequence[FloatArray]) -> Plateaus:
    """Plateaus from the settled readings under each force, in the order of time."""
    kept = [piece[~_is_glitch(piece)] for piece in pieces]
    reference = np.array(references_n, dtype=np.float64)
    return Plateaus(
        reference,
        np.array([piece.mean() for piece in kept]),
        np.array([piece.std(ddof=1) / np.sqrt(len(piece)) for piece in kept]),
        np.concatenate([[0.0], np.sign(np.diff(reference))]),
        sum(map(len, pieces)) - sum(map(len, kept)),
    )


def _settled(reading: FloatArray, settled: BoolArray | None) -> FloatArray:
    return reading[int(_SETTLING_SHARE * len(reading)) :] if settled is None else reading[settled]


def _is_glitch(piece: FloatArray) -> BoolArray:
    """Samples far off the median, if most agree; the resolution counts as noise."""
    off = np.abs(piece - np.median(piece))
    steps = np.diff(np.unique(piece))
    noise = max(_NORMAL * float(np.median(off)), float(steps.min()) if len(steps) else 0.0)
    return np.asarray(off > _OUTLIER * noise if noise else np.zeros(len(piece), dtype=np.bool_))
