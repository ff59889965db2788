"""Recursive least squares."""

from estimation.estimators.recursive import RecursiveEstimator
from robot_io.types import FloatArray


class Rls(RecursiveEstimator):
    """Least squares, one sample after the other; every sample counts the same for ever.

    Source: L. Ljung, T. Söderström, Theory and Practice of Recursive Identification (1983), sec. 2.2.
    """

    name = "rls"

    def _next_covariance(self, reduced: FloatArray, error: float) -> FloatArray:
        return reduced
