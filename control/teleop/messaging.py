"""Messaging of both sides over a line: forwards fresh messages, and detects silence and new peers.

Only one sender is the peer at a time. Frames of another sender are foreign until the peer has been silent;
then the new sender becomes the peer, and `restarts` counts it.

The offset between the two clocks follows from messages in both directions. Let t0 be the own time stamp that
the peer answers, t1 its arrival there, t2 the peer's time stamp and t3 the arrival here (t1 and t2 on the
peer's clock):

    round trip = (t3 - t0) - (t2 - t1),    offset = peer - own = ((t1 - t0) + (t2 - t3)) / 2 +- round trip / 2

(RFC 5905, section 8). The exchange with the shortest round trip of the last seconds has the smallest error.
"""

from collections import Counter, deque
from collections.abc import Callable
from enum import StrEnum
from math import inf, isfinite, nan
from typing import NamedTuple

from palpate.robot_io.clock import Clock
from palpate.robot_io.link.connection import LinkConnection
from palpate.robot_io.link.frame import Frame, FrameError
from palpate.robot_io.link.messages import Message
from palpate.robot_io.session import Column, Stream

_WINDOW_S = 2.0
_MAX_EXCHANGES = 512


class Offset(NamedTuple):
    """Offset of the peer's clock from the own clock."""

    offset_s: float  # peer minus own [s]
    round_trip_s: float  # round trip of its exchange; the offset's uncertainty is half of it [s]
    at_s: float  # end of that exchange, on the own clock [s]


class ClockOffset:
    """Keeps the exchanges of the last seconds, of which the one with the shortest round trip is the best."""

    def __init__(self) -> None:
        self._exchanges = deque[Offset](maxlen=_MAX_EXCHANGES)

    @property
    def best(self) -> Offset | None:
        """Exchange with the shortest round trip of the last seconds; None before the first."""
        return min(self._exchanges, key=lambda exchange: exchange.round_trip_s, default=None)

    def update(self, t0_s: float, t1_s: float, t2_s: float, t3_s: float) -> None:
        """Add one exchange; time stamps that are not finite or contradict each other are ignored.

        Args:
            t0_s: own time stamp that the peer answers, own clock [s].
            t1_s: arrival of that message at the peer, peer's clock [s].
            t2_s: stamp of the answer, peer's clock [s].
            t3_s: arrival of the answer, own clock [s].
        """
        round_trip_s = (t3_s - t0_s) - (t2_s - t1_s)
        if not (isfinite(round_trip_s) and round_trip_s >= 0.0 and t3_s >= t0_s):
            return
        self._exchanges.append(Offset(0.5 * ((t1_s - t0_s) + (t2_s - t3_s)), round_trip_s, t3_s))
        while self._exchanges[0].at_s < t3_s - _WINDOW_S:
            self._exchanges.popleft()


_WINDOW = 64  # number of recent sequence numbers that are tracked individually


class Arrival(StrEnum):
    """Class of a received frame; only fresh frames are processed."""

    FRESH = "fresh"
    LATE = "late"  # in transit for too long to be used
    REPEATED = "repeated"  # arrived before
    REORDERED = "reordered"  # older than the newest
    FOREIGN = "foreign"  # from another sender than the peer

    __hash__ = str.__hash__  # faster than an Enum's: every frame is counted


_LATE_S = 3.0  # longest transit time of a used frame
_SILENT_S = 1.0  # time without a fresh frame after which the peer is silent


class Peer:
    """Classifies frames by their time stamps, without I/O; times are on the own clock [s].

    Attributes:
        counts: frames by class.
        lost: gaps in the sequence so far; frames that arrive late are subtracted again.
        restarts: number of times that a new sender has replaced the peer.
    """

    def __init__(self) -> None:
        self.counts: Counter[Arrival] = Counter(dict.fromkeys(Arrival, 0))
        self.lost = 0
        self.restarts = 0
        self._clocks = ClockOffset()
        self._sender: int | None = None
        self._newest, self._seen = -1, 0
        # Smallest arrival minus time stamp: the clocks' offset plus the shortest transit time.
        self._min_lag_s = inf
        self._fresh_at_s = self._sent_s = nan

    @property
    def offset(self) -> Offset | None:
        """Offset of the peer's clock; None before the first exchange."""
        return self._clocks.best

    def silent(self, now_s: float) -> bool:
        """Return whether no fresh frame has arrived for a second, or ever.

        Args:
            now_s: own clock [s].
        """
        return not now_s - self._fresh_at_s <= _SILENT_S  # true for NaN as well

    def age_s(self, now_s: float) -> float:
        """Compute the age of the newest fresh frame's content; NaN if it is not known [s].

        Args:
            now_s: own clock [s].
        """
        return self.since_s(self._sent_s, now_s)

    def since_s(self, peer_s: float, now_s: float) -> float:
        """Compute the time since a time of the peer's clock; NaN before the offset is known [s].

        Args:
            peer_s: peer's clock [s].
            now_s: own clock [s].
        """
        offset = self.offset
        return nan if offset is None else now_s - (peer_s - offset.offset_s)

    def classify(self, frame: Frame, arrived_s: float) -> Arrival:
        """Classify a frame, and count it.

        Args:
            frame: received frame.
            arrived_s: arrival time, own clock [s].
        """
        arrival = self._classify(frame, arrived_s)
        self.counts[arrival] += 1
        if arrival is Arrival.FRESH:
            self._fresh_at_s, self._sent_s = arrived_s, frame.sent_s
        return arrival

    def _classify(self, frame: Frame, arrived_s: float) -> Arrival:
        if frame.sender != self._sender:
            if not self.silent(arrived_s):
                return Arrival.FOREIGN
            self.restarts += self._sender is not None
            self._sender, self._newest, self._seen = frame.sender, -1, 0
            self._clocks, self._min_lag_s = ClockOffset(), inf
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
        # Before the offset is known, the transit time is compared with that of the fastest frame.
        transit_s, best = arrived_s - frame.sent_s, self._clocks.best
        self._min_lag_s = min(self._min_lag_s, transit_s)
        transit_s += -self._min_lag_s if best is None else best.offset_s
        return Arrival.LATE if transit_s > _LATE_S else Arrival.FRESH


STREAM_NAME = "link"
LINK_STREAM = Stream(
    STREAM_NAME,
    (
        Column("time_s", "s", 1, "on this side's clock"),
        Column("peer_offset_s", "s", 1, "the peer's clock minus this one; NaN before it is known"),
        Column("round_trip_s", "s", 1, "of the exchange from which the offset was computed"),
        Column("age_s", "s", 1, "of the content of the newest fresh message"),
        Column("silent", "1", 1, "whether the peer is silent", "bool"),
        *(Column(kind.value, "1", 1, "frames so far", "int64") for kind in Arrival),
        Column("malformed", "1", 1, "frames so far", "int64"),
        Column("lost", "1", 1, "frames so far that never arrived", "int64"),
    ),
)


_RESUBSCRIBE_S = 3.0  # silence after which the subscription is repeated
_UNHEARD_S = 10.0  # silence after which a possible cause is reported


class Messaging:
    """Messaging over a line, with the state of the peer at its other end.

    Args:
        line: line between both sides.
        clock: clock of this side.
        take: called with each fresh message and the time it was sent, on the peer's clock [s].
        on_new_peer: called when another program has replaced the peer, before its first message.

    Attributes:
        peer: state of the other side.
        linked: whether the peer was heard when `receive` was last called.
        send: sends a message.
    """

    def __init__(
        self,
        line: LinkConnection,
        clock: Clock,
        *,
        take: Callable[[Message, float], None],
        on_new_peer: Callable[[], None],
    ) -> None:
        self.peer, self.linked = Peer(), False
        self.send = line.send
        self._line, self._clock, self._handle_message, self._on_new_peer = line, clock, take, on_new_peer
        self._asked_s, self._reported = inf, set[str]()  # when `problem` was first called, and what it said
        self._answers_another = False  # whether received frames answer another program
        self._resubscribe_s = clock.now_s() + _RESUBSCRIBE_S

    def receive(self) -> bool:
        """Process all received frames, and return whether `linked` has changed."""
        for at_s, frame in self._line.receive():
            # The sender has not received this program's frames, or the frame is a replay.
            if frame.heard_sender != self._line.sender:
                self._answers_another |= frame.heard_sender != 0
                if self.peer.silent(at_s):
                    self._line.heard(frame, at_s)
                continue
            restarts = self.peer.restarts
            arrival = self.peer.classify(frame, at_s)
            if self.peer.restarts != restarts:
                self._on_new_peer()
            if arrival is not Arrival.FRESH:
                continue
            try:
                message = frame.message
            except FrameError as error:
                self._line.refuse(str(error))
                continue
            self._line.heard(frame, at_s)
            self._handle_message(message, frame.sent_s)
        now_s = self._clock.now_s()
        was, self.linked = self.linked, not self.peer.silent(now_s)
        if self.linked:
            self._resubscribe_s = now_s + _RESUBSCRIBE_S
        elif now_s >= self._resubscribe_s:
            self._resubscribe_s = now_s + _RESUBSCRIBE_S
            self._line.resubscribe()
        return self.linked != was

    def problem(self) -> str:
        """Describe, once, why nothing may be received from the peer; empty if there is nothing new."""
        now_s, line = self._clock.now_s(), self._line
        self._asked_s = min(self._asked_s, now_s)  # silence does not count while this side starts
        if line.malformed and "refused" not in self._reported:
            self._reported.add("refused")
            return f"a frame was refused: {line.refused}"
        if (
            "unheard" in self._reported
            or self.peer.counts[Arrival.FRESH]
            or now_s < self._asked_s + _UNHEARD_S
        ):
            return ""
        self._reported.add("unheard")
        if self._answers_another:
            return f"the other side answers another program: is another {line.role} running?"
        return f"no message arrived for {_UNHEARD_S:g} s: {line.advice}"

    def record(self, now_s: float) -> tuple[object, ...]:
        """Make one record of `LINK_STREAM`, a value for each column.

        Args:
            now_s: time on this side's clock [s].
        """
        peer, offset = self.peer, self.peer.offset
        clocks = (nan, nan) if offset is None else (offset.offset_s, offset.round_trip_s)
        counts = (peer.counts[kind] for kind in Arrival)
        silent = peer.silent(now_s)
        return (now_s, *clocks, peer.age_s(now_s), silent, *counts, self._line.malformed, peer.lost)
