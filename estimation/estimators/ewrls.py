"""Recursive least squares that forgets."""

import numpy as np

from estimation.estimators.recursive import INITIAL_VARIANCE, RecursiveEstimator
from robot_io.errors import InputError
from robot_io.types import FloatArray


class Ewrls(RecursiveEstimator):
    """Exponentially weighted: a sample t steps back counts forgetting^t.

    Without excitation the covariance would grow for ever, and the next noise would throw the gains about; it
    stops growing at its starting size.

    Source: A. Haddadi, K. Hashtrudi-Zaad, Real-Time Identification of Hunt-Crossley Models, IEEE T-RO 28
    (2012).

    Args:
        forgetting: weight kept by each sample per step, in (0, 1]; 0.999 at 1 kHz remembers about a second.
        variance: of each gain at the start.
    """

    name = "ewrls"

    def __init__(self, forgetting: float = 0.999, variance: float = INITIAL_VARIANCE) -> None:
        if not 0.0 < forgetting <= 1.0:
            raise InputError(f"ewrls: forgetting {forgetting} must be above 0 and at most 1")
        super().__init__(variance)
        self.forgetting = forgetting

    def _next_covariance(self, reduced: FloatArray, error: float) -> FloatArray:
        grown: FloatArray = reduced / self.forgetting
        return grown if np.all(np.diag(grown) <= self._initial_variance) else reduced
