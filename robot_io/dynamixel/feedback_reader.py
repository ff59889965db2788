"""One sync read a tick: asks all servos for their feedback, and waits no longer than the deadline."""

from collections.abc import Sequence
from dataclasses import dataclass

from robot_io.clock import Clock
from robot_io.dynamixel import instructions
from robot_io.dynamixel.fast_reply import FastReply
from robot_io.dynamixel.feedback import FEEDBACK_SIZE, PADDING, Feedback, decode_feedback
from robot_io.dynamixel.packet import StatusPacket, StatusReader
from robot_io.dynamixel.port import SerialPort
from robot_io.errors import DeviceTimeoutError, ProtocolError

_STATUS_PACKET = 11  # bytes around the data
_LARGEST_ANSWER = _STATUS_PACKET + 4 * (FEEDBACK_SIZE + PADDING) // 3 + 1  # bytes, every third one stuffed


@dataclass(frozen=True, slots=True)
class _Request:
    """A way to ask: how many padding bytes come along, what to send, and what must come back."""

    size: int
    packet: bytes
    reply: FastReply


class FeedbackReader:
    """Asks for the feedback of all servos at once.

    The protocol has no sequence numbers: a late answer to an earlier request looks like the answer to this
    one. So the number of bytes asked for changes after each failure and whenever something came unasked, and
    an answer of another length is not taken.

    Args:
        port: an open port.
        clock: what deadlines are on.
        servo_ids: in the order of the joints.
        indirect_data: address where the padding starts.
        fast: whether the servos know the fast sync read.

    Attributes:
        lost: how many requests were not answered by all, or not in time.
    """

    def __init__(
        self, port: SerialPort, clock: Clock, servo_ids: Sequence[int], indirect_data: int, *, fast: bool
    ) -> None:
        self._port = port
        self._clock = clock
        self._ids = tuple(servo_ids)
        self._fast = fast
        ask = instructions.fast_sync_read if fast else instructions.sync_read
        self._requests = [
            _Request(size, ask(address, size, self._ids), FastReply(self._ids, size))
            for address, size in (
                (indirect_data + PADDING - extra, FEEDBACK_SIZE + extra) for extra in range(PADDING + 1)
            )
        ]
        self._turn = 0  # which of the requests is next

    @property
    def byte_count(self) -> int:
        """Bytes of one request and its answers, nothing stuffed."""
        request = self._requests[0]
        answers = request.reply.size if self._fast else len(self._ids) * (_STATUS_PACKET + request.size)
        return len(request.packet) + answers

    def read(self, deadline_s: float) -> tuple[list[Feedback], float]:
        """The feedback of all servos in their order, and when they were asked [s].

        They sample when the request has reached them, so the time is a little too early, never too late.

        Args:
            deadline_s: when to give up [s].

        Raises:
            DeviceTimeoutError: somebody did not answer properly in time, by id.
            DeviceError: the port failed.
        """
        if self._clock.now_s() >= deadline_s:
            raise DeviceTimeoutError("no time left to ask the servos")
        if self._port.discard():
            self._turn += 1
        request = self._requests[self._turn % len(self._requests)]
        asked_at_s = self._clock.now_s()
        self._port.write(request.packet)
        receive = self._receive_fast if self._fast else self._receive
        try:
            return [decode_feedback(packet) for packet in receive(request, deadline_s)], asked_at_s
        except ProtocolError as error:
            self._turn += 1
            raise DeviceTimeoutError(str(error)) from error

    def _receive_fast(self, request: _Request, deadline_s: float) -> list[StatusPacket]:
        reply, received, start = request.reply, b"", -1
        while True:
            received += self._port.wait(deadline_s)
            if start < 0:
                start = reply.start_in(received)
            if start >= 0 and len(received) - start >= reply.size:
                return reply.decode(received[start : start + reply.size])
            if self._clock.now_s() >= deadline_s:
                answered = reply.answered(received[start:]) if start >= 0 else 0
                raise ProtocolError(f"servo {self._ids[answered]} did not answer in time")

    def _receive(self, request: _Request, deadline_s: float) -> list[StatusPacket]:
        reader = StatusReader(_LARGEST_ANSWER)
        answers: dict[int, StatusPacket] = {}
        while True:
            for packet in reader.feed(self._port.wait(deadline_s)):
                of_this_request = len(packet.data) == request.size or packet.refusal is not None
                if packet.servo_id in self._ids and of_this_request:
                    answers[packet.servo_id] = packet
            if len(answers) == len(self._ids):
                return [answers[servo_id] for servo_id in self._ids]
            if self._clock.now_s() >= deadline_s:
                silent = ", ".join(str(servo_id) for servo_id in self._ids if servo_id not in answers)
                damaged = f" ({reader.rejected} damaged answers)" if reader.rejected else ""
                raise ProtocolError(f"servo {silent} did not answer in time{damaged}")
