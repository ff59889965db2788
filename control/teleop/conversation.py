"""What both sides do with the line: judge frames, hand fresh messages on, notice silence and newcomers."""

from collections.abc import Callable

from control.teleop.link_record import link_record
from control.teleop.peer import Arrival, Peer, PeerLimits
from robot_io.clock import Clock
from robot_io.link import FrameError, Line, Message

_ANEW_S = 3.0  # of silence, after which the other side is told again that this one listens
_UNHEARD_S = 10.0  # after which it is said what may be wrong


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
        self._begun_s, self._complaints = clock.now_s(), set[str]()
        self._elsewhere = False  # whether frames came that answer somebody else
        self._anew_s = self._begun_s + _ANEW_S

    def listen(self) -> bool:
        """Take in what has arrived; whether the peer is heard again, or not any more, since the last call."""
        for at_s, frame in self._line.receive():
            if frame.heard_sender != self._line.sender:  # has not heard this program, or is a recording
                self._elsewhere |= frame.heard_sender != 0
                if self.peer.silent(at_s):
                    self._line.heard(frame, at_s)
                continue
            restarts = self.peer.restarts
            arrival = self.peer.judge(frame, at_s)
            if self.peer.restarts != restarts:
                self._begin_anew()
            if arrival is not Arrival.FRESH:
                continue
            try:
                message = frame.message
            except FrameError as error:
                self._line.refuse(str(error))
                continue
            self._line.heard(frame, at_s)
            self._take(message, frame.sent_s)
        now_s = self._clock.now_s()
        was, self.linked = self.linked, not self.peer.silent(now_s)
        if self.linked:
            self._anew_s = now_s + _ANEW_S
        elif now_s >= self._anew_s:
            self._anew_s = now_s + _ANEW_S
            self._line.listen_anew()
        return self.linked != was

    def complaint(self) -> str:
        """Why the other side may not be heard, in words, each reason once; empty if there is nothing new."""
        now_s, line = self._clock.now_s(), self._line
        if line.malformed and "refused" not in self._complaints:
            self._complaints.add("refused")
            return f"a frame was refused: {line.refused}"
        if (
            "unheard" in self._complaints
            or self.peer.counts[Arrival.FRESH]
            or now_s < self._begun_s + _UNHEARD_S
        ):
            return ""
        self._complaints.add("unheard")
        if self._elsewhere:
            return f"the other side answers somebody else: is another {line.role} running?"
        return f"nobody was heard for {_UNHEARD_S:g} s: {line.advice}"

    def record(self, now_s: float) -> tuple[object, ...]:
        """How things stand with the line, as one record of `LINK_STREAM`."""
        return link_record(self.peer, self._line.malformed, now_s)
