"""What the recursive least squares have in common."""

from abc import abstractmethod

import numpy as np

from estimation.estimate import Estimate
from estimation.estimator import OnlineEstimator
from estimation.regression import Regression
from estimation.statistics.serial_covariance import sum_covariance
from estimation.statistics.uncertainty import Covariance
from robot_io.errors import InputError
from robot_io.types import FloatArray

INITIAL_VARIANCE = 1e8  # of a gain before any sample: a stiffness of 10 000 N/m is no surprise
_INITIAL_EFFORT = (
    1e3  # what any one gain may contribute to the effort, where all samples are known beforehand
)
_FORGOTTEN = 1e-9  # share of a sample's pull below which those before it need not be followed up


class RecursiveEstimator(OnlineEstimator):
    """Kalman-like update of the gains; a subclass says what becomes of the covariance after each sample.

    With row h, effort y, gains g, and covariance P (in units in which the noise has variance 1):

        error = y - h g;  K = P h / (forgetting + h P h);  g += K error;  P = next(P - K h P)

    Args:
        variance: of each gain at the start, relative to that of the noise; `fit`, which knows all samples,
            begins with more where a gain of that size would hardly show in the effort.
    """

    forgetting = 1.0

    def __init__(self, variance: float = INITIAL_VARIANCE) -> None:
        if not variance > 0:
            raise InputError(f"{self.name}: variance {variance} must be positive")
        self.variance = variance
        self.start(0)

    @abstractmethod
    def _next_covariance(self, reduced: FloatArray, error: float) -> FloatArray:
        """Covariance for the next sample, (p, p), from what is left after this one and its error."""

    def start(self, gain_count: int) -> None:
        self._begin(np.full(gain_count, self.variance))

    def _begin(self, variance: FloatArray) -> None:
        self._gains = np.zeros(len(variance))
        self._pull = np.zeros(len(variance))
        self._initial_variance = variance
        self._covariance = np.diag(variance)

    def update(self, row: FloatArray, effort: float) -> FloatArray:
        spread = self._covariance.dot(row)
        error = effort - float(row.dot(self._gains))
        self._pull = spread / (self.forgetting + float(row.dot(spread)))
        self._gains = self._gains + self._pull * error
        reduced = self._covariance - self._pull[:, None] * spread
        self._covariance = self._next_covariance(reduced, error)
        return self._gains

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        """See `Estimator.fit`; the samples are taken in their order, the last gains are the estimate."""
        rows, efforts = regression.columns, regression.effort.tolist()
        count, gain_count = rows.shape
        level = np.sqrt(np.mean(rows**2, axis=0))
        self._begin(np.maximum(self.variance, (_INITIAL_EFFORT / np.where(level > 0, level, 1.0)) ** 2))
        history, pulls = np.empty((count, gain_count)), np.empty((count, gain_count))
        for index in range(count):
            history[index] = self.update(rows[index], efforts[index])
            pulls[index] = self._pull
        gains = history[-1]
        residuals = regression.effort - regression.columns @ gains
        terms = _pull_on_last(rows, pulls) * residuals[:, None]
        summed = sum_covariance(terms, regression.run)
        covariance = Covariance(summed.matrix, max(1.0, summed.effective_count - gain_count))
        return self._estimate(regression, gains, covariance, history=history)


def _pull_on_last(rows: FloatArray, pulls: FloatArray) -> FloatArray:
    """How far one unit of noise in each sample moves the last gains, shape (n, p).

    Each later sample t takes part of it back: the gains' error goes through (I - K_t h_t).
    """
    carried = np.eye(rows.shape[1])
    effect = np.zeros_like(pulls)
    scale = np.abs(pulls[-1]).max()
    for index in range(len(rows) - 1, -1, -1):
        moved = carried @ pulls[index]
        effect[index] = moved
        carried = carried - moved[:, None] * rows[index]
        if np.abs(moved).max() < _FORGOTTEN * scale and np.abs(carried).max() < _FORGOTTEN:
            break
    return effect
