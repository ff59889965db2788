"""Recursive least squares that begins again when its errors say that something has changed."""

import numpy as np

from estimation.estimators.recursive import INITIAL_VARIANCE
from estimation.estimators.rls import Rls
from robot_io.errors import InputError
from robot_io.types import FloatArray

_ALLOWANCE = 1.0  # standard deviations of a mean error that are not summed up
_MEMORY = 0.998  # of the noise and of the columns' sizes, per sample
_WARM_UP = 20  # samples after a start in which errors are the start's
_FAR = 4.0  # standard deviations beyond which an error counts no more
_ROUNDING2 = 1e-18  # of the squared effort


class _Noise:
    """variance = floor + share * effort^2, from squared errors that fade."""

    def __init__(self) -> None:
        self._count = self._square = self._fourth = self._errors = self._products = 0.0
        self._floor = self._share = 0.0

    def variance(self, effort: float) -> float:
        """At this effort."""
        return self._floor + self._share * effort * effort + _ROUNDING2 * effort * effort

    @property
    def mean_variance(self) -> float:
        """Over the samples that it was learnt from."""
        return self._errors / self._count if self._count else 0.0

    def learn(self, error: float, effort: float, *, cut: bool) -> None:
        """Take in one error, at most `_FAR` deviations of it if `cut`."""
        square, error2 = effort * effort, error * error
        if cut:
            error2 = min(error2, _FAR**2 * self.variance(effort))
        self._count = _MEMORY * self._count + 1.0
        self._square = _MEMORY * self._square + square
        self._fourth = _MEMORY * self._fourth + square * square
        self._errors = _MEMORY * self._errors + error2
        self._products = _MEMORY * self._products + error2 * square
        self._solve()

    def _solve(self) -> None:
        """Least squares of the two, neither negative."""
        determinant = self._count * self._fourth - self._square * self._square
        if determinant > 1e-6 * self._count * self._fourth:
            self._share = (self._count * self._products - self._square * self._errors) / determinant
        self._share = min(max(self._share, 0.0), self._errors / self._square if self._square else 0.0)
        self._floor = max((self._errors - self._share * self._square) / self._count, 0.0)


class CusumRls(Rls):
    """All samples count the same, until a change: then only those after it.

    For every gain the products of column and error, over their usual size, are summed up both ways less an
    allowance (Page's CUSUM). While nothing changes the sums fall back to zero and the estimate is that of
    recursive least squares, whose variance falls with 1/n; after a change one of them reaches its limit
    within a few samples, and the covariance is that of the start again. The noise is learnt, with a part that
    grows with the effort.

    Source: E. S. Page, Continuous Inspection Schemes, Biometrika 41 (1954); F. Gustafsson, Adaptive Filtering
    and Change Detection (2000), ch. 5.

    Args:
        limit: of the sums, in standard deviations; more alarms below, later ones above.
        variance: of each gain at the start.
    """

    name = "cusum_rls"

    def __init__(self, limit: float = 30.0, variance: float = INITIAL_VARIANCE) -> None:
        if not limit > 0.0:
            raise InputError(f"cusum_rls: limit {limit} must be positive")
        self.limit = limit
        super().__init__(variance)

    def _begin(self, variance: FloatArray) -> None:
        super()._begin(variance)
        self._size2 = [0.0] * len(variance)
        self._noise = _Noise()
        self.changes = 0  # found since the start
        self._listen()

    def _listen(self) -> None:
        self._samples = 0
        self._up = [0.0] * len(self._size2)
        self._down = self._up.copy()

    def update(self, row: FloatArray, effort: float) -> FloatArray:
        error = effort - float(row.dot(self._gains))
        columns = row.tolist()
        self._samples += 1
        fresh = max(1.0 - _MEMORY, 1.0 / self._samples)
        self._size2 = [
            size2 + fresh * (column * column - size2)
            for size2, column in zip(self._size2, columns, strict=True)
        ]
        if self._samples > _WARM_UP:
            learnt = self._samples > 2 * _WARM_UP or self.changes > 0
            if learnt:
                unsure = self._noise.mean_variance * float(row.dot(self._covariance.dot(row)))
                variance = self._noise.variance(effort - error) + unsure  # rounding may take it below zero
                self._sum_up(columns, error, max(variance, 0.0) ** 0.5)
            self._noise.learn(error, effort - error, cut=learnt)
        return super().update(row, effort)

    def _sum_up(self, columns: list[float], error: float, noise: float) -> None:
        """Add one error to the sums, and begin again where one is beyond the limit."""
        standardised = min(max(error / noise, -_FAR), _FAR) if noise > 0.0 else 0.0
        for index, (column, size2) in enumerate(zip(columns, self._size2, strict=True)):
            push = standardised * column / size2**0.5 if size2 > 0.0 else 0.0
            self._up[index] = max(self._up[index] + push - _ALLOWANCE, 0.0)
            self._down[index] = max(self._down[index] - push - _ALLOWANCE, 0.0)
        if max(*self._up, *self._down) > self.limit:
            self._covariance = np.diag(self._initial_variance)
            self.changes += 1
            self._listen()
