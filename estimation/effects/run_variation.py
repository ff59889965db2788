"""What differs from run to run: specimens, spots, zeros and gains."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from estimation.signals.blocks import places
from robot_io.types import BoolArray, FloatArray, IntArray

_TELLING = 0.25  # of a run's samples, from its start, that tell the run's own value
_SINGULAR = 1e-10


class RunVariation(SensorEffect):
    """A random effect: each run has values of its own, drawn from a Gaussian about zero.

        reading = effort + B(q) b_r,  b_r ~ N(0, spread^2) in run r

    A run that is held out cannot know its b_r from other runs. So every run tells it by itself: least squares
    over its first part (`told`), shrunken by `share`,

        reading = effort + share B(q) b_first,  share = spread^2 / (spread^2 + variance of b_first)

    the best linear prediction of the rest (Henderson 1975). Share 1 means that runs do differ and stay as
    they begin, 0 that what the first part shows is noise. As the first part of a run is used like that
    whether it is held out or not, no gain is fitted to a held-out run, and one formula does for all.

    Judging: the samples of `told` are to be left out of the error wherever a model with such an effect is
    compared with one without, since their own effort has been used; `spread` is for the report.
    """

    signals = ("recorded",)
    channels = frozenset(ChannelKind)
    linear = False
    inner: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", 0.0, 1.0, (0.2, 1.0)),)

    @abstractmethod
    def basis(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """What a run's own values multiply, shape (n, k)."""

    def told(self, data: ChannelData) -> BoolArray:
        """Samples that tell their run's own values, shape (n,)."""
        starts, piece = places(data.run)
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
        basis = self.basis(effort, data, inner)
        weight = (self.told(data) if rows is None else rows).astype(np.float64)[:, None]
        return _least_squares(basis, weight, data.effort - effort, places(data.run)[0])

    def spread(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Standard deviation of the values from run to run, shape (k,), noise of the first part taken off."""
        return np.sqrt(inner["share"] * np.mean(self.values(effort, data, inner) ** 2, axis=0))

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.sense`."""
        if effort.ndim == 2:
            return np.column_stack([self.sense(column, data, inner) for column in effort.T] or [effort])
        own = self.values(effort, data, inner)[places(data.run)[1]]
        return effort + inner["share"] * np.sum(self.basis(effort, data, inner) * own, axis=1)

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`."""
        return tuple({"share": share} for share in (0.3, 0.7, 0.95))


def _least_squares(basis: FloatArray, weight: FloatArray, target: FloatArray, starts: IntArray) -> FloatArray:
    """Solutions run by run, (runs, k); zero in directions that a run's first part does not show."""
    weighted = weight * basis
    squares = np.add.reduceat(weighted[:, :, None] * basis[:, None, :], starts)
    sums = np.add.reduceat(weighted * target[:, None], starts)
    inverse = np.linalg.pinv(squares, rcond=_SINGULAR, hermitian=True)
    return np.asarray(np.einsum("rij,rj->ri", inverse, sums))
