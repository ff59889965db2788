"""RANSAC sample by sample: hypotheses that compete while the arm is probing."""

import random

import numpy as np

from estimation.estimators.recursive import INITIAL_VARIANCE
from estimation.estimators.rls import Rls
from robot_io.errors import InputError
from robot_io.types import FloatArray

_HYPOTHESES = 24
_EVERY = 6  # samples between two new hypotheses
_RECENT = 150  # samples that hypotheses are drawn from
_STEP = 0.03  # by which a running median moves up or down per sample
_AHEAD = 0.4  # of the estimate's own median: a rival's below it is better
_MEDIAN_TO_SIGMA = 1.4826
_CUT = 4.0  # standard deviations
_SEED = 1


class PreemptiveRansac(Rls):
    """Least squares of the samples that agree with it, for as long as no rival agrees better with most.

    Every few samples as many of the recent ones as there are gains are drawn and solved; the hypothesis joins
    a pool in the place of the worst. Each sample moves the running median of every hypothesis' errors. The
    recursive estimate is one of the pool; it learns from its inliers alone, and begins again at a rival whose
    median is clearly smaller. The work of a sample is always the same.

    Source: D. Nister, Preemptive RANSAC for Live Structure and Motion Estimation, ICCV 2003.

    Args:
        threshold: largest error of an inlier, in the effort's unit; None for four times the noise, which is
            taken from the running median.
        variance: of each gain at the start.
    """

    name = "preemptive_ransac"

    def __init__(self, threshold: float | None = None, variance: float = INITIAL_VARIANCE) -> None:
        if threshold is not None and not threshold > 0.0:
            raise InputError(f"preemptive_ransac: threshold {threshold} must be positive")
        self.threshold = threshold
        super().__init__(variance)

    def _begin(self, variance: FloatArray) -> None:
        super()._begin(variance)
        count = len(variance)
        self._pool = np.zeros((_HYPOTHESES, count))  # the first is the recursive estimate
        self._medians = np.zeros(_HYPOTHESES)
        self._rows = np.zeros((_RECENT, count))
        self._efforts = np.zeros(_RECENT)
        self._samples = 0
        self._random = random.Random(_SEED)  # noqa: S311, no secret

    def update(self, row: FloatArray, effort: float) -> FloatArray:
        at = self._samples % _RECENT
        self._rows[at], self._efforts[at] = row, effort
        self._samples += 1
        distance = np.abs(self._pool.dot(row) - effort)
        starting = self._samples <= 2 * len(row)
        if starting:
            self._medians = np.maximum(self._medians, abs(effort))
        else:
            self._medians *= np.where(distance > self._medians, 1.0 + _STEP, 1.0 - _STEP)
            if self._samples % _EVERY == 0:
                self._compete()
        limit = self.threshold or _CUT * _MEDIAN_TO_SIGMA * float(self._medians[0])
        if starting or float(distance[0]) <= limit:
            self._pool[0] = super().update(row, effort)
        else:
            self._pull = np.zeros(len(row))
        return self._gains

    def _compete(self) -> None:
        """Follow a rival that is clearly ahead, and put a new hypothesis in the place of the worst."""
        best = int(self._medians.argmin())
        if self._medians[best] < _AHEAD * self._medians[0]:
            self._gains = self._pool[best].copy()
            self._pool[0], self._medians[0] = self._gains, self._medians[best]
            self._covariance = np.diag(self._initial_variance)
        drawn = self._random.sample(range(min(self._samples, _RECENT)), len(self._gains))
        worst = 1 + int(self._medians[1:].argmax())
        try:
            self._pool[worst] = np.linalg.solve(self._rows[drawn], self._efforts[drawn])
        except np.linalg.LinAlgError:
            return  # these samples determine nothing
        self._medians[worst] = 2.0 * self._medians[0]
