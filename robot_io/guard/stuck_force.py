"""Finds a force sensor that has frozen: it goes on sending samples, and all of them are one number.

A sound sensor repeats itself too: its steps are coarse, it is filtered, it holds zero on purpose, or nothing
shakes it. So one is accused only while the arm moves, and only of a row that is no chance. With a share p of
samples that are equal to the one before, k equal ones in a row come by chance with a probability of p^k. The
share is learnt from the sensor's own samples, and from its noise: readings on the edge between two steps
alternate, and stand still in the middle of one. Noise is what goes up and down by more than one step: a row
of ups is a push, and one step is an edge. Filtered readings repeat themselves in flocks, so a row must also
be much longer than any before it. A sensor that has stood still for the whole time while the arm moved, and
came to life again, is one that does so, and is not accused any more.
"""

from math import inf, log, nan

from robot_io.guard.limits import Problem
from robot_io.types import Measurement

_LEAST_KNOWN = 100  # samples, before anything is said
_LEAST_SHARE = 0.05  # the least share assumed of any sensor
_IMPROBABLE = -log(1e-9)
_LONGER = 3  # times the longest row so far
# Times a step, over what a sample goes up and down beyond one: no less than p in the middle of a step, for
# normal noise of any size.
_NOISE_SHARE = 0.25
_MOST_STEPS = 8.0  # a larger jump is a blow, and no more noise than this
_MOVED_RAD = 0.002  # a joint, since the row began; more than a coarse encoder trembles

_REMEDY = (
    "check the load cell's cable and amplifier, and switch it off and on again; if it shows one number by "
    "nature, raise limits.stuck_force_s"
)


class StuckForce:
    """Remembers how often the force repeats itself, and how long it has now; a row of `time_s` counts [s]."""

    def __init__(self, time_s: float) -> None:
        self._time_s = time_s
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self._sampled_at_s = self._since_s = -inf
        self._force_n = nan
        self._since_rad: list[float] = []
        self._row = self._longest = 0  # samples in a row that were equal to the one before
        self._equal = self._known = 0  # samples that were, and all samples, before this row
        self._jump_n = nan  # the last change
        self._step_n = inf  # smallest change so far
        self._noise_n = 0.0  # sum of the changes that went back, each beyond one step
        self._enough: float = inf  # such a row is no chance
        self._rests = False  # it is known to stand still by nature

    def problem(self, measurement: Measurement) -> Problem | None:
        """What to say of a force that is stuck, or None; a sample that was seen before says nothing."""
        sampled_at_s, force_n = measurement.force_at_s, measurement.force_n
        if not sampled_at_s > self._sampled_at_s:
            return None
        lasted_s = self._sampled_at_s - self._since_s
        self._sampled_at_s = sampled_at_s
        if force_n != self._force_n:
            self._learn(lasted_s >= self._time_s, measurement)
            self._since_s, self._since_rad = sampled_at_s, measurement.joint_position_rad.tolist()
            self._jump_n, self._force_n = force_n - self._force_n, force_n
            return None
        self._row += 1
        if self._row > self._enough and sampled_at_s - self._since_s >= self._time_s - 1e-9:
            if self._rests or not self._has_moved(measurement):
                return None
            return Problem(
                f"force sensor: stuck at {force_n:.4g} N, {self._row + 1} equal samples in a row while the "
                "arm moved",
                _REMEDY,
            )
        return None

    def _has_moved(self, measurement: Measurement) -> bool:
        """Whether the arm has, since the row began."""
        positions_rad = zip(measurement.joint_position_rad.tolist(), self._since_rad, strict=True)
        return any(abs(now - then) > _MOVED_RAD for now, then in positions_rad)

    def _learn(self, was_long: bool, measurement: Measurement) -> None:
        """From the row that has ended with this measurement."""
        jump_n = measurement.force_n - self._force_n
        self._step_n = min(self._step_n, abs(jump_n))
        if jump_n * self._jump_n < 0.0:
            self._noise_n += min(abs(jump_n), _MOST_STEPS * self._step_n) - self._step_n
        row, self._row = self._row, 0
        if was_long:  # what it does while the arm stands says nothing of what it does while it moves
            self._rests |= self._has_moved(measurement)
            return
        self._equal += row
        self._known += row + 1
        self._longest = max(self._longest, row)
        if self._known >= _LEAST_KNOWN:
            self._enough = self._no_chance()

    def _no_chance(self) -> float:
        """The number of equal samples in a row that is none."""
        if not self._noise_n:
            return inf
        noise_n = self._noise_n / self._known
        share = max(self._equal / self._known, _LEAST_SHARE, _NOISE_SHARE * self._step_n / noise_n)
        return max(_IMPROBABLE / -log(share), _LONGER * self._longest) if share < 1.0 else inf
