"""What is known of the other side from its frames: which of them count, how old they are, is it there.

One sender is listened to at a time. Another one's frames are foreign until the first has been silent for so
long that it is taken for gone; then the newcomer is the peer, and whoever asks is told (`restarts`).
"""

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from math import inf, nan

from control.teleop.clock_offset import ClockOffset, Offset
from robot_io.errors import InputError
from robot_io.link import Frame

_WINDOW = 64  # sequence numbers below the newest that are known one by one


class Arrival(StrEnum):
    """What a frame is. Only a fresh one counts."""

    FRESH = "fresh"
    LATE = "late"  # under way for too long to act on
    REPEATED = "repeated"  # was here before
    REORDERED = "reordered"  # an older one than the newest, which says more than it
    FOREIGN = "foreign"  # of another sender than the peer

    __hash__ = str.__hash__  # not in Python, as an Enum's is: every frame is counted


@dataclass(frozen=True, slots=True)
class PeerLimits:
    """When a frame is too old, and when its sender is gone."""

    late_s: float = 3.0  # a frame that was longer under way is not acted on [s]
    silent_s: float = 1.0  # without a fresh frame for so long, the peer is silent [s]

    def __post_init__(self) -> None:
        if not (0.0 < self.silent_s <= 60.0 and 0.0 < self.late_s <= 60.0):
            raise InputError(f"late_s {self.late_s}, silent_s {self.silent_s}: each above 0 and at most 60 s")


class Peer:
    """Judges frames by their stamps; pure, time is an argument on the own clock [s]."""

    def __init__(self, limits: PeerLimits) -> None:
        self._limits = limits
        self.counts: Counter[Arrival] = Counter(dict.fromkeys(Arrival, 0))
        self.lost = 0  # gaps in the sequence so far; what comes in late is taken off again
        self.restarts = 0  # how often the peer's place was taken by a new sender
        self._clocks = ClockOffset()
        self._sender: int | None = None
        self._newest, self._seen = -1, 0
        self._fastest_s = inf  # least of arrival minus stamp: two clocks' offset and the shortest way
        self._fresh_at_s = self._sent_s = nan

    @property
    def offset(self) -> Offset | None:
        """How far the peer's clock is ahead; None before the first exchange."""
        return self._clocks.best

    def silent(self, now_s: float) -> bool:
        """Whether nothing fresh has come for `silent_s`, or ever."""
        return not now_s - self._fresh_at_s <= self._limits.silent_s  # also NaN

    def age_s(self, now_s: float) -> float:
        """Age of what the newest fresh frame says [s]; NaN before there is one, or the offset is known."""
        return self.since_s(self._sent_s, now_s)

    def since_s(self, peer_s: float, now_s: float) -> float:
        """How long ago a time of the peer's clock was [s]; NaN before the offset is known."""
        return nan if self.offset is None else now_s - (peer_s - self.offset.offset_s)

    def judge(self, frame: Frame, arrived_s: float) -> Arrival:
        """Say what a frame is, and count it."""
        arrival = self._judge(frame, arrived_s)
        self.counts[arrival] += 1
        if arrival is Arrival.FRESH:
            self._fresh_at_s, self._sent_s = arrived_s, frame.sent_s
        return arrival

    def _judge(self, frame: Frame, arrived_s: float) -> Arrival:
        if frame.sender != self._sender:
            if not self.silent(arrived_s):
                return Arrival.FOREIGN
            self._begin(frame.sender)
        behind = self._newest - frame.sequence
        if behind >= 0:
            if behind >= _WINDOW or self._seen >> behind & 1:
                return Arrival.REPEATED
            self._seen |= 1 << behind
            self.lost -= 1
            return Arrival.REORDERED
        self.lost += -behind - 1 if self._newest >= 0 else 0
        self._seen = (self._seen << min(-behind, _WINDOW) | 1) & ((1 << _WINDOW) - 1)
        self._newest = frame.sequence
        self._clocks.update(frame.heard_sent_s, frame.heard_at_s, frame.sent_s, arrived_s)
        return Arrival.LATE if self._way_s(frame, arrived_s) > self._limits.late_s else Arrival.FRESH

    def _way_s(self, frame: Frame, arrived_s: float) -> float:
        """How long the frame was under way; before the offset is known, how much longer than the fastest."""
        way_s, best = arrived_s - frame.sent_s, self._clocks.best
        self._fastest_s = min(self._fastest_s, way_s)
        return way_s - self._fastest_s if best is None else way_s + best.offset_s

    def _begin(self, sender: int) -> None:
        self.restarts += self._sender is not None
        self._sender, self._newest, self._seen = sender, -1, 0
        self._clocks, self._fastest_s = ClockOffset(), inf
