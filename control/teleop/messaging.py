"""Messaging of both sides over a line: forwards fresh messages, and detects silence and new peers."""

from collections.abc import Callable
from math import nan

from palpate.control.teleop.peer import Arrival, Peer, PeerLimits
from palpate.robot_io.clock import Clock
from palpate.robot_io.link.connection import LinkConnection
from palpate.robot_io.link.frame import FrameError
from palpate.robot_io.link.messages import Message
from palpate.robot_io.session import Column, Stream

STREAM_NAME = "link"
LINK_STREAM = Stream(
    STREAM_NAME,
    (
        Column("time_s", "s", 1, "on this side's clock"),
        Column("peer_offset_s", "s", 1, "the peer's clock minus this one; NaN before it is known"),
        Column("round_trip_s", "s", 1, "of the exchange that the offset comes from"),
        Column("age_s", "s", 1, "of what the newest fresh message says"),
        Column("silent", "1", 1, "whether the peer is silent", "bool"),
        *(Column(kind.value, "1", 1, "frames so far", "int64") for kind in Arrival),
        Column("malformed", "1", 1, "frames so far", "int64"),
        Column("lost", "1", 1, "frames that never came, so far", "int64"),
    ),
)


def link_record(peer: Peer, malformed: int, now_s: float) -> tuple[object, ...]:
    """Make one record of `LINK_STREAM`.

    Args:
        peer: state of the other side.
        malformed: number of malformed frames so far.
        now_s: time on the clock of this side [s].
    """
    offset = peer.offset
    clocks = (nan, nan) if offset is None else (offset.offset_s, offset.round_trip_s)
    counts = (peer.counts[kind] for kind in Arrival)
    return (now_s, *clocks, peer.age_s(now_s), peer.silent(now_s), *counts, malformed, peer.lost)


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
        self.peer, self.linked = Peer(PeerLimits()), False
        self.send = line.send
        self._line, self._clock, self._handle_message, self._on_new_peer = line, clock, take, on_new_peer
        self._begun_s, self._reported = clock.now_s(), set[str]()
        self._answers_another = False  # whether received frames answer another program
        self._resubscribe_s = self._begun_s + _RESUBSCRIBE_S

    def receive(self) -> bool:
        """Process all received frames.

        Returns:
            Whether `linked` has changed.
        """
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
        """Describe, once, why nothing may be received from the peer.

        Returns:
            One sentence; empty if there is nothing new.
        """
        now_s, line = self._clock.now_s(), self._line
        if line.malformed and "refused" not in self._reported:
            self._reported.add("refused")
            return f"a frame was refused: {line.refused}"
        if (
            "unheard" in self._reported
            or self.peer.counts[Arrival.FRESH]
            or now_s < self._begun_s + _UNHEARD_S
        ):
            return ""
        self._reported.add("unheard")
        if self._answers_another:
            return f"the other side answers another program: is another {line.role} running?"
        return f"no message arrived for {_UNHEARD_S:g} s: {line.advice}"

    def record(self, now_s: float) -> tuple[object, ...]:
        """Make one record of `LINK_STREAM`.

        Args:
            now_s: time on this side's clock [s].

        Returns:
            A value for each column.
        """
        return link_record(self.peer, self._line.malformed, now_s)
