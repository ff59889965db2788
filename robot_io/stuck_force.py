"""Finds a force sensor that has frozen: it goes on sending samples, and all of them are one number.

A coarse or noiseless sensor repeats itself too. How often is learnt from its own samples: with a share p of
samples that were equal to the one before, k equal ones in a row come by chance with a probability of p^k.
Readings that are filtered repeat themselves in flocks, so a row must also be much longer than any before it.
"""

from math import inf, log, nan

from robot_io.problem import Problem
from robot_io.types import Measurement

_LEAST_KNOWN = 100  # samples, before anything is said
_LEAST_SHARE = 0.05  # less is not believed of any sensor
_IMPROBABLE = -log(1e-9)
_LONGER = 3  # times the longest row so far

_REMEDY = "check the load cell's cable and amplifier, and switch it off and on again"


class StuckForce:
    """Remembers how often the force repeats itself, and how long it has now.

    Args:
        time_s: how long a row must last to count [s].
    """

    def __init__(self, time_s: float) -> None:
        self._time_s = time_s
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self._sampled_at_s = -inf
        self._force_n = nan
        self._since_s = 0.0
        self._row = self._longest = 0  # samples in a row that were equal to the one before
        self._equal = self._known = 0  # samples that were, and all samples, before this row
        self._enough = inf  # such a row is no chance

    def problem(self, measurement: Measurement) -> Problem | None:
        """What to say of a force that is stuck, or None; a sample that was seen before says nothing."""
        sampled_at_s, force_n = measurement.force_at_s, measurement.force_n
        if not sampled_at_s > self._sampled_at_s:
            return None
        self._sampled_at_s = sampled_at_s
        if force_n != self._force_n:
            self._learn()
            self._force_n, self._since_s = force_n, sampled_at_s
            return None
        self._row += 1
        if self._row > self._enough and sampled_at_s - self._since_s >= self._time_s - 1e-9:
            return Problem(
                f"force sensor: stuck at {force_n:.4g} N, {self._row + 1} equal samples in a row", _REMEDY
            )
        return None

    def _learn(self) -> None:
        """From the row that has ended."""
        self._equal += self._row
        self._known += self._row + 1
        self._longest, self._row = max(self._longest, self._row), 0
        if self._known >= _LEAST_KNOWN:
            share = max(self._equal / self._known, _LEAST_SHARE)  # below one: this sample was different
            self._enough = max(_IMPROBABLE / -log(share), _LONGER * self._longest)
