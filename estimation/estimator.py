"""Interface of estimators, which solve a linear problem for parameters with their uncertainty."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from palpate.estimation.estimate import Estimate
from palpate.estimation.fit.irls import Loss
from palpate.estimation.model import Regression
from palpate.estimation.statistics.uncertainty import Covariance, assemble
from palpate.robot_io.types import BoolArray, FloatArray


class Estimator(ABC):
    """Method that solves effort = columns @ gains + noise."""

    name: ClassVar[str]  # as on the command line
    # In the search for parameters that the effort is not linear in, which comes before.
    loss: ClassVar[Loss] = Loss.LINEAR

    @abstractmethod
    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        """Estimate the gains from all samples.

        Args:
            regression: the problem; samples of a run in order of time.
            rng: source of every random choice; the same state gives the same estimate.

        Raises:
            InputError: the method cannot work on these samples.
        """

    def _estimate(
        self,
        regression: Regression,
        gains: FloatArray,
        covariance: Covariance,
        *,
        inliers: BoolArray | None = None,
        history: FloatArray | None = None,
        details: dict[str, float] | None = None,
    ) -> Estimate:
        """Assemble the estimate with its diagnostics; see `assemble`."""
        return assemble(
            self.name,
            regression.names,
            regression.units,
            gains,
            jacobian=regression.columns,
            effort=regression.effort,
            residuals=regression.effort - regression.columns @ gains,
            covariance=covariance,
            inliers=inliers,
            history=history,
            details=details,
        )


class OnlineEstimator(Estimator):
    """An estimator that takes one sample at a time."""

    @abstractmethod
    def start(self, gain_count: int) -> None:
        """Reset, and prepare for rows of a number of columns.

        Args:
            gain_count: number of columns of each row.
        """

    @abstractmethod
    def update(self, row: FloatArray, effort: float) -> FloatArray:
        """Update the gains by one sample.

        Args:
            row: shape (p,), one row of the columns.
            effort: what was measured with it.

        Returns:
            The gains after it, shape (p,); the array is never written to again.
        """
