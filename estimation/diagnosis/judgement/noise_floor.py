"""How small the error can get: from free air, from repeats, and from what no smooth law can explain."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.fit.held_out import held_out_residual
from estimation.fit.standing import Standing
from estimation.signals.blocks import rows_of_runs
from robot_io.types import FloatArray, IntArray

_ALIKE = 0.02  # two runs are repeats if their positions differ by less than this share of the range
_AS_LONG = 0.9  # of the longer run, that a repeat lasts
_FREE = 0.9  # of the samples before a touch; the last of them may already belong to it
_LEAST = 50  # samples
_ENOUGH = 2000  # pairs of runs to compare; of the others of very many runs, only neighbours are


@dataclass(frozen=True)
class NoiseFloor:
    """The floor and what it rests on, in the unit of the effort.

    Attributes:
        value: the error that a complete model would leave in held-out runs.
        free_air: noise before the first touch of each run; None if there is no free air.
        repeats: noise from runs that repeat a motion; None if there are none.
        share_left: share of the held-out error that a flexible regression still explains.
    """

    value: float
    free_air: float | None
    repeats: float | None
    share_left: float


def noise_floor(standing: Standing, energy: float = np.inf) -> NoiseFloor:
    """The floor, judged from where things stand.

    Args:
        standing: the model.
        energy: on blocks of held-out runs, that a flexible regression left beside another model.
    """
    residual = held_out_residual(standing.plain.frame, standing.trial)
    return NoiseFloor(
        standing.floor(energy),
        free_air(standing.data),
        repeats(standing.data, residual),
        standing.left_of_blocks(energy),
    )


def free_air(data: ChannelData) -> float | None:
    """Standard deviation of the effort before the first touch of each run, about that run's mean."""
    if data.kind is not ChannelKind.CONTACT:
        return None
    parts = []
    for rows in rows_of_runs(data.run):
        pressed = data.engaged[rows]
        before = rows[: int(np.argmax(pressed)) if pressed.any() else len(rows)]
        before = before[: int(_FREE * len(before))]
        if len(before) >= _LEAST:
            parts.append(data.effort[before] - data.effort[before].mean())
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) if parts else None


def repeats(data: ChannelData, residual: FloatArray) -> float | None:
    """Standard deviation of the residual (n,) that does not come back when a motion is repeated."""
    differences = [residual[one] - residual[other] for one, other in _pairs(data)]
    if not differences:
        return None
    both = np.concatenate(differences)
    return float(np.sqrt(np.nanmean(both**2) / 2.0))


def _pairs(data: ChannelData) -> Iterator[tuple[IntArray, IntArray]]:
    """Rows of each two runs with the same motion, cut to the shorter."""
    span = float(np.ptp(data.position)) or 1.0
    for one, other in _compared(rows_of_runs(data.run)):
        count = min(len(one), len(other))
        if count < _LEAST or count < _AS_LONG * max(len(one), len(other)):
            continue
        first, second = one[:count], other[:count]
        if np.sqrt(np.mean((data.position[first] - data.position[second]) ** 2)) < _ALIKE * span:
            yield first, second


def _compared(rows: list[IntArray]) -> Iterator[tuple[IntArray, IntArray]]:
    """Each two runs, the nearest in number first; as many as are enough."""
    count = 0
    for apart in range(1, len(rows)):
        if count >= _ENOUGH:
            return
        yield from zip(rows, rows[apart:], strict=False)
        count += len(rows) - apart
