"""The offset between two clocks, from the stamps of messages that go both ways.

With t0 the own stamp that the peer answers to, t1 its arrival there, t2 the peer's stamp and t3 the arrival
here (t1, t2 on the peer's clock),

    round trip = (t3 - t0) - (t2 - t1),    offset = peer - own = ((t1 - t0) + (t2 - t3)) / 2 +- round trip / 2

(RFC 5905, section 8). The exchange with the shortest round trip of the last seconds has the smallest error.
"""

from collections import deque
from math import isfinite
from typing import NamedTuple

_WINDOW_S = 2.0
_MOST = 512


class Offset(NamedTuple):
    """How far the peer's clock is ahead of the own one."""

    offset_s: float  # peer minus own [s]
    round_trip_s: float  # of the exchange that it comes from; the offset is known to half of it [s]
    at_s: float  # when that exchange ended, on the own clock [s]


class ClockOffset:
    """Knows the exchange of the last seconds with the shortest round trip."""

    def __init__(self) -> None:
        # By age, and each with a shorter round trip than all that are younger: the first one is the best.
        self._kept: deque[Offset] = deque()

    @property
    def best(self) -> Offset | None:
        """The exchange with the shortest round trip of the last seconds; None before the first."""
        return self._kept[0] if self._kept else None

    def update(self, t0_s: float, t1_s: float, t2_s: float, t3_s: float) -> None:
        """Take in one exchange; stamps that are not finite or contradict each other are left out."""
        round_trip_s = (t3_s - t0_s) - (t2_s - t1_s)
        if not (isfinite(round_trip_s) and round_trip_s >= 0.0 and t3_s >= t0_s):
            return
        kept = self._kept
        while kept and kept[-1].round_trip_s >= round_trip_s:
            kept.pop()
        kept.append(Offset(0.5 * ((t1_s - t0_s) + (t2_s - t3_s)), round_trip_s, t3_s))
        while kept[0].at_s < t3_s - _WINDOW_S or len(kept) > _MOST:
            kept.popleft()
