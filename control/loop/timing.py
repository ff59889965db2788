"""Histograms of the durations of a tick's sections, and the time grid of ticks."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from palpate.robot_io.types import FloatArray, IntArray

_BINS_PER_OCTAVE = 32  # a bin is 2.2 % wide, so a percentile is right to 1.1 %
_FIRST_BIN = -24 * _BINS_PER_OCTAVE  # 60 ns: shorter ones are counted as zero
_LAST_BIN = 5 * _BINS_PER_OCTAVE  # 32 s: longer ones are counted in the last bin
_BATCH = 256  # ticks counted at once, which takes little longer than counting one


class TickDurations(NamedTuple):
    """Durations of one tick's sections that are complete when its record is made [s]."""

    read_s: float
    control_s: float
    guard_s: float
    write_s: float
    observer_s: float
    log_s: float  # duration of logging the previous tick
    lateness_s: float  # delay of the wake-up on the loop's clock; zero on simulated time


SECTIONS = (*(name.removesuffix("_s") for name in TickDurations._fields), "tick")


@dataclass(frozen=True, slots=True)
class SectionTiming:
    """Distribution of one section's duration over a run."""

    count: int  # number of ticks
    p50_s: float  # median [s]
    p99_s: float  # 99th percentile [s]
    p999_s: float  # 99.9th percentile [s]
    max_s: float  # longest [s], exact


class Histogram:
    """Durations in fixed bins of constant relative width, 60 ns to 32 s."""

    def __init__(self) -> None:
        self.max_s = 0.0
        self._bins: IntArray = np.zeros(_LAST_BIN - _FIRST_BIN + 1, dtype=np.int64)

    @property
    def count(self) -> int:
        """Number of durations counted."""
        return int(self._bins.sum())

    def add(self, durations_s: FloatArray) -> None:
        """Count durations.

        Args:
            durations_s: shape (n,) [s].
        """
        octaves = np.log2(np.clip(durations_s, 1e-9, 1e9))
        bins = np.floor(octaves * _BINS_PER_OCTAVE).astype(np.int64).clip(_FIRST_BIN, _LAST_BIN) - _FIRST_BIN
        self._bins += np.bincount(bins, minlength=len(self._bins))
        self.max_s = max(self.max_s, float(durations_s.max(initial=0.0)))

    def percentile(self, percent: float) -> float:
        """Compute a percentile with an error of at most 1.1 %.

        Args:
            percent: 0 to 100.

        Returns:
            Duration that `percent` of the counted durations did not exceed [s]; 0 below 60 ns, NaN without
            any.
        """
        if not self.count:
            return math.nan
        rank = max(1, math.ceil(percent / 100.0 * self.count - 1e-9))  # 99.9 % of 1000 is 999, not 1000
        index = int(np.searchsorted(np.cumsum(self._bins), rank))
        middle_s = math.exp2((_FIRST_BIN + index + 0.5) / _BINS_PER_OCTAVE)
        return min(middle_s, self.max_s) if index else 0.0

    def summary(self) -> SectionTiming:
        """Compute the reported figures."""
        return SectionTiming(
            self.count, self.percentile(50.0), self.percentile(99.0), self.percentile(99.9), self.max_s
        )


class LoopTiming:
    """Histograms of each section and of the whole tick without its lateness."""

    def __init__(self) -> None:
        self._recent: list[TickDurations] = []
        self._histograms = {name: Histogram() for name in SECTIONS}

    def add(self, durations: TickDurations) -> None:
        """Count one tick.

        Args:
            durations: durations of the tick's sections [s].
        """
        self._recent.append(durations)
        if len(self._recent) == _BATCH:
            self._count_recent()

    def _count_recent(self) -> None:
        durations_s = np.array(self._recent).reshape(-1, len(TickDurations._fields))
        self._recent.clear()
        tick_s = durations_s.sum(axis=1) - durations_s[:, TickDurations._fields.index("lateness_s")]
        for histogram, column_s in zip(self._histograms.values(), (*durations_s.T, tick_s), strict=True):
            histogram.add(column_s)

    def summary(self) -> Mapping[str, SectionTiming]:
        """Compute the figures by section, in the order of `SECTIONS`."""
        self._count_recent()
        return MappingProxyType({name: histogram.summary() for name, histogram in self._histograms.items()})


@dataclass
class TickGrid:
    """Time grid `start_s + k * period_s`, traversed in order.

    Each instant is computed from the start, never from the previous tick, so rounding does not accumulate. A
    tick that still runs when the next one is due has overrun. The grid then continues at the next instant
    ahead; instants in between are skipped.
    """

    start_s: float  # time of the first tick
    period_s: float
    index: int = 0
    overruns: int = 0  # ticks that ended after the next one was due
    skipped: int = 0  # instants without a tick

    @property
    def due_s(self) -> float:
        """When the current tick is due [s]."""
        return self.start_s + self.index * self.period_s

    def advance(self, now_s: float) -> int:
        """Advance to the next tick; return the number of periods to it, more than 1 after an overrun.

        Args:
            now_s: end of the current tick, loop's clock [s].
        """
        previous = self.index
        self.index = previous + 1
        if now_s > self.due_s:
            # Rounding may put the ceiling one instant early; the instant must not have passed.
            self.index = max(self.index, math.ceil((now_s - self.start_s) / self.period_s))
            self.index += now_s > self.due_s
            self.overruns += 1
            self.skipped += self.index - previous - 1
        return self.index - previous
