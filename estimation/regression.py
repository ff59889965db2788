"""The linear problem that every estimator solves."""

from dataclasses import dataclass

import numpy as np

from robot_io.errors import InputError
from robot_io.types import FloatArray


@dataclass(frozen=True)
class Regression:
    """effort = columns @ gains + noise.

    Attributes:
        columns: shape (n, p).
        effort: shape (n,).
        names: the p gains' names.
        units: the p gains' units.
        sigma: standard deviation of each sample's noise, shape (n,), up to a common factor; None for equal.
    """

    columns: FloatArray
    effort: FloatArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    sigma: FloatArray | None = None

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
        if samples <= gains:
            raise InputError(f"regression: {samples} samples cannot determine {gains} parameters")

    @property
    def condition_number(self) -> float:
        """Condition number of the columns, each scaled to unit length (so units do not matter)."""
        lengths = np.linalg.norm(self.columns, axis=0)
        if not lengths.all():
            return float("inf")
        return float(np.linalg.cond(self.columns / lengths))
