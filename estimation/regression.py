"""The linear problem that every estimator solves."""

from dataclasses import dataclass, replace

import numpy as np

from robot_io.errors import InputError
from robot_io.types import BoolArray, FloatArray, IntArray


def weights_of(sigma: FloatArray | None, count: int) -> FloatArray:
    """1 / sigma with mean square 1, shape (count,); ones if the noise is equal."""
    if sigma is None:
        return np.ones(count)
    inverse: FloatArray = 1.0 / sigma
    return np.asarray(inverse / np.sqrt(np.mean(inverse**2)))


@dataclass(frozen=True)
class Regression:
    """effort = columns @ gains + noise.

    Attributes:
        columns: shape (n, p).
        effort: shape (n,).
        names: the p gains' names.
        units: the p gains' units.
        sigma: standard deviation of each sample's noise, shape (n,), up to a common factor; None for equal.
        run: number of the run of each sample, shape (n,); the noise of samples of one run, in order of time,
            may be correlated, that of different runs is not. None for one run.
    """

    columns: FloatArray
    effort: FloatArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    sigma: FloatArray | None = None
    run: IntArray | None = None

    def __post_init__(self) -> None:
        """Check shapes.

        Raises:
            InputError: they do not belong together, or there are fewer samples than gains.
        """
        samples, gains = self.columns.shape
        if self.effort.shape != (samples,) or len(self.names) != gains or len(self.units) != gains:
            raise InputError(
                f"regression: columns {self.columns.shape}, effort {self.effort.shape}, names {self.names}"
            )
        for what, values in (("sigma", self.sigma), ("run", self.run)):
            if values is not None and values.shape != (samples,):
                raise InputError(f"regression: {what} has shape {values.shape}, expected ({samples},)")
        if samples <= gains:
            raise InputError(f"regression: {samples} samples cannot determine {gains} parameters")

    def select(self, rows: BoolArray | IntArray) -> "Regression":
        """The problem with only these samples (a mask or indices)."""
        sigma = None if self.sigma is None else self.sigma[rows]
        run = None if self.run is None else self.run[rows]
        return replace(self, columns=self.columns[rows], effort=self.effort[rows], sigma=sigma, run=run)

    @property
    def weights(self) -> FloatArray:
        """See `weights_of`."""
        return weights_of(self.sigma, len(self.effort))

    @property
    def condition_number(self) -> float:
        """Condition number of the columns, each scaled to unit length (so units do not matter)."""
        lengths = np.linalg.norm(self.columns, axis=0)
        if not lengths.all():
            return float("inf")
        return float(np.linalg.cond(self.columns / lengths))
