"""The fitting problem: which samples count, how much, and what given parameters leave of the effort."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from estimation.channel import ChannelData
from estimation.effect import Parameter
from estimation.fitting.search_scale import SearchScale
from estimation.model import Model
from estimation.regression import Regression, weights_of
from robot_io.types import BoolArray, FloatArray

Bounds = Mapping[str, tuple[float, float]]
NO_BOUNDS: Bounds = MappingProxyType({})

STEP = 1e-5  # of an inner parameter in a difference quotient, on the scale of its typical range


class Problem:
    """A model and a channel, as a search sees them.

    The model always sees whole runs, since some effects remember; `rows` says which samples count.

    Args:
        model: what to fit.
        data: the channel.
        rows: samples that count, shape (n,); None for all.
        sigma: noise of each sample, shape (n,), up to a common factor; None for equal.
        within: narrower bounds of inner parameters than physics has, by "effect.parameter".
    """

    def __init__(
        self,
        model: Model,
        data: ChannelData,
        rows: BoolArray | None = None,
        sigma: FloatArray | None = None,
        within: Bounds = NO_BOUNDS,
    ) -> None:
        self.model = model
        self.data = data
        self.rows = np.ones(len(data), dtype=np.bool_) if rows is None else rows
        self.sigma = sigma
        self.within = within
        self.scale = SearchScale({name: _narrowed(p, within.get(name)) for name, p in model.inner.items()})

    def regression(self, vector: FloatArray) -> Regression:
        """The linear problem in the samples that count, at these inner parameters (q,)."""
        whole = self.model.regression(self.data, self.scale.values(vector), sigma=self.sigma)
        return whole if self.rows.all() else whole.select(self.rows)

    @property
    def weights(self) -> FloatArray:
        """1 / sigma of the samples that count, with mean square 1."""
        sigma = None if self.sigma is None else self.sigma[self.rows]
        return weights_of(sigma, int(np.count_nonzero(self.rows)))

    def parameters(self, gains: FloatArray, vector: FloatArray) -> dict[str, float]:
        """Gains, then inner parameters, by "effect.parameter"."""
        return dict(zip(self.model.gains, gains.tolist(), strict=True)) | self.scale.values(vector)

    def residuals(self, gains: FloatArray, vector: FloatArray) -> FloatArray:
        """Effort minus prediction, shape (n,), of all samples of the channel."""
        return self.data.effort - self.model.predict(self.data, self.parameters(gains, vector))

    def slopes(self, gains: FloatArray, vector: FloatArray) -> FloatArray:
        """Change of the prediction with each gain and each search variable, shape (n, p + q), all samples."""
        by_gain, _ = self.model.linearise(self.data, self.parameters(gains, vector))
        lower, upper = self.scale.bounds
        columns = [by_gain]
        for index in range(len(vector)):
            ahead, behind = vector.copy(), vector.copy()
            ahead[index] = min(vector[index] + STEP, upper[index])
            behind[index] = max(vector[index] - STEP, lower[index])
            change = self.residuals(gains, behind) - self.residuals(gains, ahead)
            columns.append((change / (ahead[index] - behind[index]))[:, None])
        return np.hstack(columns)


def _narrowed(parameter: Parameter, within: tuple[float, float] | None) -> Parameter:
    if within is None:
        return parameter
    low, high = within
    return replace(parameter, lower=max(low, parameter.lower), upper=min(high, parameter.upper))
