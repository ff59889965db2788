"""Read all servos once per tick, and assign each answer the time of its request."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, Generic, Protocol, TypeVar

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.servo.stream import PacketStream, ServoAnswer
from palpate.robot_io.errors import DeviceTimeoutError, ProtocolError
from palpate.robot_io.serial_port import SerialPort


class ServoFeedback(Protocol):
    """State of all servos of a line, in their own units."""

    @property
    def fault_texts(self) -> list[str]:
        """Names of each servo's errors, or an empty string."""


FeedbackType = TypeVar("FeedbackType", bound=ServoFeedback)

_LATEST_S = 0.1  # no answer comes later than this after its request: USB adapters hold bytes for 16 ms


@dataclass(slots=True, eq=False)
class FeedbackRequest:
    """One request to all servos. `asked_at_s` is its time [s], minus infinity once it is answered."""

    packet: bytes  # bytes of the request
    size: int  # number of bytes requested from each servo
    asked_at_s: float = -inf
    answers: dict[int, ServoAnswer] = field(default_factory=dict)  # by servo id


class FeedbackReader(Generic[FeedbackType]):
    """Requests the feedback of all servos at once, and gives each answer the time of its request.

    The protocols have no sequence numbers, but the length of an answer depends on the number of requested
    padding bytes. So each request differs in length from all unanswered ones, and an answer that arrives
    ticks late is not taken for the newest. While every length is in use, nothing is requested until an answer
    arrives or the oldest request is 0.1 s old.

    Args:
        asking: Request for each number of bytes that can be requested from each servo, the smallest first.
        packets: Parser of the received bytes.
        decode: Converts the packets of all servos, in their order, to feedback; raises ProtocolError if one
            cannot be read.
        overhead: Bytes of an answer in addition to its data.
    """

    def __init__(
        self,
        port: SerialPort,
        clock: Clock,
        servo_ids: Sequence[int],
        *,
        asking: Mapping[int, bytes],
        packets: PacketStream[Any],
        decode: Callable[[Sequence[Any]], FeedbackType],
        overhead: int,
    ) -> None:
        self._port, self._clock, self._ids = port, clock, tuple(servo_ids)
        self._requests = {size: FeedbackRequest(packet, size) for size, packet in asking.items()}
        self._next_requests = list(self._requests.values())  # the first one is next
        self._open: list[FeedbackRequest] = []  # without an answer, the oldest first
        self._packets, self._decode, self._overhead = packets, decode, overhead
        self._newest_request = self._next_requests[0]
        self._problem = ""

    @property
    def byte_count(self) -> int:
        """Number of bytes of one request and its answers, without byte stuffing."""
        shortest = next(iter(self._requests.values()))
        return len(shortest.packet) + self._answer_size(shortest.size)

    def _answer_size(self, size: int) -> int:
        """Number of bytes of all answers to a request for `size` bytes."""
        return len(self._ids) * (self._overhead + size)

    def read(self, deadline_s: float) -> tuple[FeedbackType, float]:
        """Request the feedback of all servos, and wait for their answers.

        Args:
            deadline_s: End of the wait, on the robot's clock [s].

        Returns:
            The newest feedback of all servos, and the time of its request [s]. The servos
            sample when the request has reached them, so this time is a little too early, never too late.

        Raises:
            DeviceTimeoutError: No complete answer came before the deadline; names the silent servo's id.
            DeviceError: The port failed.
        """
        now_s = self._clock.now_s()
        if now_s >= deadline_s:
            raise DeviceTimeoutError("no time left in this tick to read the servos")
        newest = None
        received = self._port.read_all()
        if received:  # unexpected or late: the next request must differ from it
            newest = self._newest(received)
            self._next_requests.append(self._next_requests.pop(0))
        self._problem = ""
        asked_at_s = self._ask(now_s)
        # Usually only this request is open. Its answers are then decoded at once, as soon as all have
        # come. A refusal is shorter than an answer, so it is reported at the deadline.
        request = self._newest_request
        data, size = b"", self._answer_size(request.size) if self._open == [request] else 0
        while newest is None or newest[1] < asked_at_s:
            data += self._port.wait(deadline_s)
            if len(data) < size and self._clock.now_s() < deadline_s:
                continue
            newest = self._newest(data) or newest
            if newest is not None and newest[1] >= asked_at_s:
                break
            if self._problem or self._clock.now_s() >= deadline_s:
                break
            data, size = b"", 0
        if self._open and self._newest_request in self._open:
            # Its answer may still arrive, so its length is the last to be used again.
            self._next_requests.remove(self._newest_request)
            self._next_requests.append(self._newest_request)
        if newest is None:
            raise DeviceTimeoutError(self._problem or self._describe_silence(self._newest_request))
        return newest

    def _ask(self, now_s: float) -> float:
        """Send a request of unused length; return its time [s], minus infinity if all are in use."""
        for request in self._next_requests:
            if now_s - request.asked_at_s > _LATEST_S:
                if request.asked_at_s > -inf:
                    self._close(request)
                self._open.append(request)
                request.asked_at_s = now_s
                request.answers.clear()
                self._port.write(request.packet)
                self._newest_request = request
                return now_s
        return -inf

    def _newest(self, data: bytes) -> tuple[FeedbackType, float] | None:
        """Return the last complete answer that ends in `data`, and the time of its request [s]."""
        if len(self._open) == 1:
            request = self._open[0]
            feedback = self._decode_whole(request, data)
            if feedback is not None:
                asked_at_s = request.asked_at_s
                self._close(request)
                return feedback, asked_at_s
        newest = None
        for request, packets in self._answers(data):
            if request.asked_at_s == -inf:
                continue  # a second answer to the same request
            try:
                newest = self._decode(packets), request.asked_at_s
            except ProtocolError as error:
                self._problem = str(error)
            # Answers arrive in the order of the requests, so no answers to earlier requests follow.
            answered_s = request.asked_at_s
            for earlier in [earlier for earlier in self._open if earlier.asked_at_s <= answered_s]:
                self._close(earlier)
        return newest

    def _close(self, request: FeedbackRequest) -> None:
        """Stop expecting an answer to a request."""
        if request.asked_at_s > -inf:
            request.asked_at_s = -inf
            self._open.remove(request)

    def _decode_whole(self, request: FeedbackRequest, data: bytes) -> FeedbackType | None:
        """Decode all answers to the only open request at once; None if the bytes are anything else."""
        return None

    def _oldest_open(self, servo_id: int | None = None) -> FeedbackRequest | None:
        """Return the first unanswered request, of this servo if given."""
        # An answer without a usable length, damaged or a refusal, belongs to this request or a later one.
        return next((request for request in self._open if servo_id not in request.answers), None)

    def _answers(self, data: bytes) -> Iterator[tuple[FeedbackRequest, Sequence[ServoAnswer]]]:
        """Yield requests whose answers are complete with `data`, each with all servos' packets in order."""
        ids = self._ids
        for packet in self._packets.feed(data):
            request, servo_id = self._requests.get(len(packet.data)), packet.servo_id
            if packet.refusal is not None:
                request = self._oldest_open(servo_id)
            if request is not None and servo_id in ids:
                answers = request.answers
                answers[servo_id] = packet
                if len(answers) == len(ids):
                    yield request, [answers[servo_id] for servo_id in ids]

    def _describe_silence(self, request: FeedbackRequest) -> str:
        """Name the servos that did not answer; none if all answered, but too late for a further request."""
        silent = ", ".join(str(servo_id) for servo_id in self._ids if servo_id not in request.answers)
        subject = f"servo {silent}" if silent else "the servos"
        damaged = f" ({self._packets.rejected} damaged answers)" if self._packets.rejected else ""
        return f"{subject} did not answer in time{damaged}"
