"""A gain that differs from run to run."""

import numpy as np

from estimation.channel import ChannelData
from estimation.effect import Inner
from estimation.effects.run_variation import RunVariation
from estimation.kinds import Kind
from estimation.signals.blocks import block_index
from robot_io.types import BoolArray, FloatArray

_TELLING = 0.25  # of a run's squared effort


class RunGain(RunVariation):
    """reading = (1 + b_r) effort in run r, b_r Gaussian about zero; the run's first part tells it.

    Here that part lasts until a quarter of the squared effort has come in: free air tells of no gain.
    """

    name = "run_gain"
    kind = Kind.RUN_DIFFERENCES
    physics = "Specimens, spots or battery voltages differ: all of the effort is larger in one run."
    equation = "reading = (1 + b_r) effort, b_r ~ N(0, spread^2)"
    source = "N. M. Laird, J. H. Ware, Biometrics 38 (1982): random-effects models for longitudinal data"
    signature = "each run has the shape of the others and a height of its own"
    signals = ("effort", "recorded")
    confused_with = {
        "torque_gain": "record more runs: a wrong constant is the same in all",
        "run_offset": "look where the effort is small: an offset is there too, a gain is not",
        "recorded_dependence": "record the suspected cause, such as a temperature, beside",
    }

    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `RunVariation.basis`: here it is the effort itself, which only the model knows."""
        return np.zeros((len(data), 1))

    def values(
        self, effort: FloatArray, data: ChannelData, inner: Inner, rows: BoolArray | None = None
    ) -> FloatArray:
        """See `RunVariation.values`: by how much each run's effort is larger; nothing where there is none."""
        chosen = self.first_part(data) if rows is None else rows
        starts, _ = block_index(data.run)
        squares = np.add.reduceat(chosen * effort**2, starts)
        products = np.add.reduceat(chosen * effort * (data.effort - effort), starts)
        return np.asarray(products / np.where(squares > 0.0, squares, np.inf))[:, None]

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        if effort.ndim == 2:
            return np.stack([self.sense(column, data, inner) for column in effort.T], axis=1)
        own = self.values(effort, data, inner)[block_index(data.run)[1], 0]
        return np.asarray(effort * (1.0 + inner["share"] * own))

    def follow(
        self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner
    ) -> tuple[FloatArray, FloatArray]:
        """See `SensorEffect.follow`; the runs' gains as they are."""
        times = 1.0 + inner["share"] * self.values(effort, data, inner)[block_index(data.run)[1]]
        return columns * times, effort * times[:, 0]

    def first_part(self, data: ChannelData) -> BoolArray:
        starts, piece = block_index(data.run)
        total = np.cumsum(data.effort**2)
        before = np.concatenate([[0.0], total])[starts]
        whole = np.append(before[1:], total[-1:]) - before
        return np.asarray(total - before[piece] <= _TELLING * whole[piece])
