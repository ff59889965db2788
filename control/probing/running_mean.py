"""Mean and spread of a signal, sample by sample."""

import math


class RunningMean:
    """Welford's recursion, which keeps its digits when the mean is large (Technometrics 4(3), 1962)."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = 0.0
        self._squares = 0.0

    def add(self, value: float) -> None:
        """Take in one sample."""
        self.count += 1
        before = value - self.mean
        self.mean += before / self.count
        self._squares += before * (value - self.mean)

    @property
    def standard_deviation(self) -> float:
        """Of the samples so far; 0 for fewer than two."""
        return math.sqrt(self._squares / (self.count - 1)) if self.count > 1 else 0.0
