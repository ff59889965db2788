"""What differs from run to run: specimens, spots, zeros and gains."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from estimation.signals.blocks import block_index
from robot_io.types import BoolArray, FloatArray, IntArray

_TELLING = 0.25  # of a run's samples, from its start, that tell the run's own value
_FEWEST_RUNS = 3
_COMMON = 2.0  # times the standard deviation of runs: their mean, which is by chance less than that
_SINGULAR = 1e-10


class RunVariation(SensorEffect):
    """A random effect: each run has values of its own, drawn from a Gaussian about zero.

        reading = effort + B(q) b_r,  b_r ~ N(0, spread^2) in run r

    A run that is held out cannot know its b_r from other runs. So every run tells it by itself: least squares
    over its first part (`first_part`), shrunken by `share`,

        reading = effort + share B(q) b_first,  share = spread^2 / (spread^2 + variance of b_first)

    the best linear prediction of the rest (Henderson 1975). Share 1 means that runs do differ and stay as
    they begin, 0 that what the first part shows is noise. As the first part of a run is used like that
    whether it is held out or not, no gain is fitted to a held-out run, and one formula does for all.

    Judging: the samples of `first_part` are left out of the error wherever a model with such an effect is
    compared with one without, since their own effort has been used; `spread` is for the report.
    """

    signals: ClassVar[tuple[str, ...]] = ("recorded",)
    channels = frozenset(ChannelKind)
    linear = False
    inner: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", 0.0, 1.0, (0.2, 1.0)),)

    @abstractmethod
    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        """What a run's own values multiply, shape (n, k)."""

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`; fewer runs than three say nothing of how runs vary."""
        return super().applies_to(data) and len(data.runs) >= _FEWEST_RUNS

    def first_part(self, data: ChannelData) -> BoolArray:
        """Samples that tell their run's own values, shape (n,)."""
        starts, piece = block_index(data.run)
        count = np.diff(np.append(starts, len(data)))[piece]
        return np.arange(len(data)) - starts[piece] < np.ceil(_TELLING * count)

    def values(
        self, effort: FloatArray, data: ChannelData, inner: Inner, rows: BoolArray | None = None
    ) -> FloatArray:
        """Each run's own values b, by least squares over its first part, shape (runs, k).

        Args:
            effort: that the model expects without variation, shape (n,).
            data: with the readings.
            inner: inner parameters.
            rows: samples to use instead, shape (n,), such as all of them.
        """
        chosen = self.first_part(data) if rows is None else rows
        left = (data.effort - effort)[:, None]
        return _least_squares(self.basis(data, inner), chosen, left, block_index(data.run)[0])[:, :, 0]

    def spread(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Standard deviation of the values from run to run, shape (k,), noise of the first part taken off.

        About their mean: what all runs have in common, the model lacks.
        """
        own = self.values(effort, data, inner)
        return np.asarray(np.sqrt(inner["share"] * np.var(own, axis=0, ddof=1)))

    def is_common(self, effort: FloatArray, data: ChannelData, inner: Inner) -> bool:
        """Whether the runs have more in common than they differ by: then the model lacks a constant.

        Args:
            effort: that the model expects without variation, shape (n,).
            data: with the readings.
            inner: inner parameters.
        """
        own = self.values(effort, data, inner)
        spread = np.linalg.norm(np.std(own, axis=0, ddof=1))
        return bool(np.linalg.norm(np.mean(own, axis=0)) > _COMMON * spread)

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        columns = effort.reshape(len(data), -1)
        return (columns + self._of_runs(data.effort[:, None] - columns, data, inner)).reshape(effort.shape)

    def follow(
        self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner
    ) -> tuple[FloatArray, FloatArray]:
        """See `SensorEffect.follow`: what the model explains of a run's first part is not the run's own."""
        own = self._of_runs(np.column_stack([columns, data.effort - effort]), data, inner)
        return columns - own[:, :-1], effort + own[:, -1]

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`."""
        return self.follow(effort, columns, data, inner)[0]

    def _of_runs(self, left: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """What runs' own values make of what was left of their first parts, (n, m) both."""
        basis = self.basis(data, inner)
        starts, piece = block_index(data.run)
        own = _least_squares(basis, self.first_part(data), left, starts)
        return np.asarray(inner["share"] * np.einsum("nk,nkm->nm", basis, own[piece]))

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return tuple({"share": share} for share in (0.3, 0.7, 0.95))


def _least_squares(basis: FloatArray, rows: BoolArray, target: FloatArray, starts: IntArray) -> FloatArray:
    """Solutions (runs, k, m) for targets (n, m); zero in directions that a run's rows do not show."""
    chosen = rows[:, None] * basis
    squares = np.add.reduceat(chosen[:, :, None] * basis[:, None, :], starts)
    sums = np.add.reduceat(chosen[:, :, None] * target[:, None, :], starts)
    return np.asarray(np.linalg.pinv(squares, rcond=_SINGULAR, hermitian=True) @ sums)
