"""What both sides do with the line: judge frames, hand fresh messages on, notice silence and newcomers."""

from collections.abc import Callable

from control.teleop.link_record import link_record
from control.teleop.peer import Arrival, Peer, PeerLimits
from robot_io.clock import Clock
from robot_io.link import FrameError, Line, Message


class Conversation:
    """A line with what is known of whoever is at its other end.

    Args:
        line: between the two.
        clock: of this side.
        take: is handed each fresh message and when it was sent, on the peer's clock [s].
        begin_anew: is called where another program has taken the peer's place, before its first message.

    Attributes:
        peer: what is known of the other side.
        linked: whether it was heard when last listened to.
    """

    def __init__(
        self,
        line: Line,
        clock: Clock,
        *,
        take: Callable[[Message, float], None],
        begin_anew: Callable[[], None],
    ) -> None:
        self.peer, self.linked = Peer(PeerLimits()), False
        self.say = line.send
        self._line, self._clock, self._take, self._begin_anew = line, clock, take, begin_anew

    def listen(self) -> bool:
        """Take in what has arrived; whether the peer is heard again, or not any more, since the last call."""
        for at_s, frame in self._line.receive():
            restarts = self.peer.restarts
            arrival = self.peer.judge(frame, at_s)
            if self.peer.restarts != restarts:
                self._begin_anew()
            if arrival is not Arrival.FRESH:
                continue
            try:
                message = frame.message
            except FrameError:
                self._line.malformed += 1
                continue
            self._line.heard(frame, at_s)
            self._take(message, frame.sent_s)
        was, self.linked = self.linked, not self.peer.silent(self._clock.now_s())
        return self.linked != was

    def record(self, now_s: float) -> tuple[object, ...]:
        """How things stand with the line, as one record of `LINK_STREAM`."""
        return link_record(self.peer, self._line.malformed, now_s)
