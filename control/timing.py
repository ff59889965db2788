"""How long the sections of a tick take, in histograms: constant memory and cost, however long the run."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

SECTIONS = ("read", "guard", "control", "write", "observer", "log", "tick", "lateness")

_BINS_PER_OCTAVE = 32  # a bin is 2.2 % wide, so a percentile is right to 1.1 %
_FLOOR_S = 60e-9  # shorter ones are counted as zero


@dataclass(frozen=True, slots=True)
class SectionTiming:
    """Distribution of one section's duration over a run.

    Attributes:
        count: number of ticks.
        p50_s: median [s].
        p99_s: 99th percentile [s].
        p999_s: 99.9th percentile [s].
        max_s: longest [s], exact.
    """

    count: int
    p50_s: float
    p99_s: float
    p999_s: float
    max_s: float


class Histogram:
    """Durations in bins of constant relative width."""

    def __init__(self) -> None:
        self.count = 0
        self.max_s = 0.0
        self._bins: defaultdict[int, int] = defaultdict(int)  # by floor(log2(duration) * bins per octave)

    def add(self, duration_s: float) -> None:
        """Count one duration [s]."""
        self.count += 1
        if duration_s > self.max_s:  # noqa: PLR1730 - eight times a tick, a comparison costs less than max()
            self.max_s = duration_s
        if duration_s >= _FLOOR_S:
            self._bins[math.floor(math.log2(duration_s) * _BINS_PER_OCTAVE)] += 1

    def percentile(self, percent: float) -> float:
        """Duration [s] that `percent` of the ticks did not exceed, to 1.1 %; 0 below 60 ns, NaN if empty."""
        if not self.count:
            return math.nan
        rank = max(1, math.ceil(percent / 100.0 * self.count - 1e-9))  # 99.9 % of 1000 is 999, not 1000
        seen = self.count - sum(self._bins.values())
        if seen >= rank:
            return 0.0
        for bin_index, ticks in sorted(self._bins.items()):
            seen += ticks
            if seen >= rank:
                middle_s = math.exp2((bin_index + 0.5) / _BINS_PER_OCTAVE)
                return min(middle_s, self.max_s)
        return self.max_s

    def summary(self) -> SectionTiming:
        """The figures that are reported."""
        return SectionTiming(
            self.count, self.percentile(50.0), self.percentile(99.0), self.percentile(99.9), self.max_s
        )


class LoopTiming:
    """One histogram for each section.

    `tick` is the time from waking up until the record is logged; `lateness` is the time from the instant when
    the tick was due until the loop woke up, on the loop's own clock (zero on simulated time).
    """

    def __init__(self) -> None:
        self._histograms = [Histogram() for _ in SECTIONS]

    def add(self, durations_s: Sequence[float]) -> None:
        """Count one tick.

        Args:
            durations_s: one duration per section, in the order of `SECTIONS` [s].
        """
        for histogram, duration_s in zip(self._histograms, durations_s, strict=True):
            histogram.add(duration_s)

    def summary(self) -> Mapping[str, SectionTiming]:
        """Figures by section, in the order of `SECTIONS`."""
        return MappingProxyType(
            {name: histogram.summary() for name, histogram in zip(SECTIONS, self._histograms, strict=True)}
        )
