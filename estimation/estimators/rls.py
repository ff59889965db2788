"""Recursive least squares."""

from estimation.estimators.recursive import RecursiveEstimator
from robot_io.types import FloatArray


class Rls(RecursiveEstimator):
    """Least squares, one sample after the other; every sample counts the same for ever."""

    name = "rls"
    summary = "recursive least squares: online, all samples count the same"
    source = "L. Ljung, T. Söderström, Theory and Practice of Recursive Identification (1983), sec. 2.2"

    def _next_covariance(self, reduced: FloatArray, error: float) -> FloatArray:
        return reduced
