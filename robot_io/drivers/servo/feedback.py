"""Reads all servos once a tick, and dates each answer by the request that it belongs to."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, Generic, TypeVar

from robot_io.clock import Clock
from robot_io.drivers.servo.dialect import Packet
from robot_io.drivers.servo.stream import PacketStream
from robot_io.errors import DeviceTimeoutError, ProtocolError
from robot_io.serial_port import SerialPort

FeedbackType = TypeVar("FeedbackType")

_LATEST_S = 0.1  # no answer comes later than this after its request: USB adapters hold bytes for 16 ms


@dataclass(slots=True)
class Request:
    """A way to ask. `asked_at_s` is when it was sent, None once it is answered [s]."""

    packet: bytes  # what is sent
    size: int  # bytes asked of each servo
    asked_at_s: float | None = None
    answers: dict[int, Packet] = field(default_factory=dict)  # by servo id


class FeedbackReader(Generic[FeedbackType]):
    """Asks for the feedback of all servos at once, and dates each answer by the request that it belongs to.

    The protocols have no sequence numbers, but answers differ in length by the number of padding bytes asked
    for. So the next request differs in length from all that are not answered yet: an answer that comes ticks
    late is as old as its request, and never passes for the newest. When every length is taken, nothing is
    asked until an answer comes or the oldest request is 0.1 s old.

    Args:
        port: an open port.
        clock: what deadlines are on.
        servo_ids: who is asked, in this order.
        asking: what is sent for each number of bytes that can be asked of each servo, the least one first.
        packets: finds packets in what comes.
        decode: makes feedback of one; ProtocolError: it cannot be read.
        around: bytes of an answer around its data.
    """

    def __init__(
        self,
        port: SerialPort,
        clock: Clock,
        servo_ids: Sequence[int],
        *,
        asking: Mapping[int, bytes],
        packets: PacketStream[Any],
        decode: Callable[[Packet], FeedbackType],
        around: int,
    ) -> None:
        self._port, self._clock, self._ids = port, clock, tuple(servo_ids)
        self._requests = {size: Request(packet, size) for size, packet in asking.items()}
        self._in_turn = list(self._requests.values())  # the first one is next
        self._packets, self._decode, self._around = packets, decode, around
        self._asked = self._in_turn[0]
        self._problem = ""

    @property
    def byte_count(self) -> int:
        """Bytes of one request and its answers, nothing stuffed."""
        least = next(iter(self._requests.values()))
        return len(least.packet) + self._answer_size(least.size)

    def _answer_size(self, size: int) -> int:
        """Bytes of all answers to a request for `size` bytes."""
        return len(self._ids) * (self._around + size)

    def read(self, deadline_s: float) -> tuple[list[FeedbackType], float]:
        """The newest feedback of all servos in their order, and when they were asked for it [s].

        They sample when the request has reached them, so the time is a little too early, never too late.

        DeviceTimeoutError: no complete answer came before `deadline_s`, with the silent servo's id;
        DeviceError: the port failed.
        """
        if self._clock.now_s() >= deadline_s:
            raise DeviceTimeoutError("no time left to ask the servos")
        self._problem = ""
        came = self._port.read_all()
        newest = self._newest(came)
        if came:  # unasked, or late: what is asked now must differ from it
            self._in_turn.append(self._in_turn.pop(0))
        asked = self._ask()
        self._asked = asked or self._asked
        asked_at_s = -inf if asked is None or asked.asked_at_s is None else asked.asked_at_s
        while newest is None or newest[1] < asked_at_s:
            newest = self._newest(self._port.wait(deadline_s)) or newest
            if self._problem or self._clock.now_s() >= deadline_s:
                break
        if asked is not None and asked.asked_at_s is not None:
            self._in_turn.append(self._in_turn.pop(self._in_turn.index(asked)))
        if newest is None:
            raise DeviceTimeoutError(self._problem or self._silence(self._asked))
        return newest

    def _ask(self) -> Request | None:
        """Send the next request whose length no unanswered one has."""
        now_s = self._clock.now_s()
        for request in self._in_turn:
            if request.asked_at_s is None or now_s - request.asked_at_s > _LATEST_S:
                request.asked_at_s, request.answers = now_s, {}
                self._port.write(request.packet)
                return request
        return None

    def _newest(self, data: bytes) -> tuple[list[FeedbackType], float] | None:
        """The last complete answer that ends in `data`, and when it was asked for [s]."""
        newest = None
        for request, packets in self._answers(data):
            if request.asked_at_s is None:
                continue  # a second answer
            try:
                newest = [self._decode(packet) for packet in packets], request.asked_at_s
            except ProtocolError as error:
                self._problem = str(error)
            self._forget_up_to(request.asked_at_s)
        return newest

    def _forget_up_to(self, asked_at_s: float) -> None:
        """Answers come in the order of the requests: those to this one and to earlier ones are over."""
        for request in self._in_turn:
            if request.asked_at_s is not None and request.asked_at_s <= asked_at_s:
                request.asked_at_s = None

    def _oldest_open(self, servo_id: int | None = None) -> Request | None:
        """The first request that is not answered, by this servo if one is given.

        An answer whose length says nothing, damaged or a refusal, belongs to this one or a later one.
        """
        still_open = [
            (request.asked_at_s, size)
            for size, request in self._requests.items()
            if request.asked_at_s is not None and servo_id not in request.answers
        ]
        return self._requests[min(still_open)[1]] if still_open else None

    def _answers(self, data: bytes) -> Iterator[tuple[Request, Sequence[Packet]]]:
        """Requests whose answers are complete with `data`, each with all servos' packets in their order."""
        for packet in self._packets.feed(data):
            request = self._requests.get(len(packet.data))
            if packet.refusal is not None:
                request = self._oldest_open(packet.servo_id)
            if request is not None and packet.servo_id in self._ids:
                request.answers[packet.servo_id] = packet
                if len(request.answers) == len(self._ids):
                    yield request, [request.answers[servo_id] for servo_id in self._ids]

    def _silence(self, asked: Request) -> str:
        """Who did not answer."""
        silent = ", ".join(str(servo_id) for servo_id in self._ids if servo_id not in asked.answers)
        damaged = f" ({self._packets.rejected} damaged answers)" if self._packets.rejected else ""
        return f"servo {silent} did not answer in time{damaged}"
