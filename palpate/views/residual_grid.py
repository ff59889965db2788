"""Mean residual over position and velocity."""

from dataclasses import dataclass

import numpy as np

from estimation.channel import ChannelData
from robot_io.types import FloatArray

OUTER = 0.002  # share of the samples beyond each end of the grid
LEAST = 3  # samples in a cell that is shown


@dataclass(frozen=True)
class ResidualGrid:
    """Cells over the state.

    Attributes:
        position: centres (p,) in the channel's unit.
        velocity: centres (v,).
        mean: mean residual (v, p); NaN where there are too few samples.
    """

    position: FloatArray
    velocity: FloatArray
    mean: FloatArray


def residual_grid(data: ChannelData, residual: FloatArray, cells: int) -> ResidualGrid:
    """Average a residual (n,) over `cells` x `cells` cells; a contact only while pressed."""
    used = np.isfinite(residual) & data.engaged
    position, velocity, left = data.position[used], data.velocity[used], residual[used]
    edges = [_edges(position, cells), _edges(velocity, cells)]
    counts = np.histogram2d(position, velocity, edges)[0].T
    sums = np.histogram2d(position, velocity, edges, weights=left)[0].T
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(counts >= LEAST, sums / counts, np.nan)
    return ResidualGrid(_centres(edges[0]), _centres(edges[1]), mean)


def _edges(values: FloatArray, cells: int) -> FloatArray:
    if not len(values):
        return np.linspace(0.0, 1.0, cells + 1)
    low, high = np.quantile(values, [OUTER, 1 - OUTER])
    return np.linspace(low, high if high > low else low + 1.0, cells + 1)


def _centres(edges: FloatArray) -> FloatArray:
    centres: FloatArray = (edges[1:] + edges[:-1]) / 2
    return centres
