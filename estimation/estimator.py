"""Interface of estimators, which solve a linear problem for parameters and their uncertainty."""

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
    # Loss of the preceding search for inner (nonlinear) parameters.
    loss: ClassVar[Loss] = Loss.LINEAR

    @abstractmethod
    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        """Estimate the gains from all samples.

        Args:
            regression: the problem; samples of a run in order of time.
            rng: random generator; the same state gives the same estimate.

        Raises:
            InputError: the method cannot use these samples.
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
        """Reset the estimator for a given number of columns.

        Args:
            gain_count: number of columns of each row.
        """

    @abstractmethod
    def update(self, row: FloatArray, effort: float) -> FloatArray:
        """Update the gains by one sample.

        Args:
            row: one row of the columns, shape (p,).
            effort: measured effort of this sample.

        Returns:
            The updated gains, shape (p,); the estimator never writes to this array again.
        """
