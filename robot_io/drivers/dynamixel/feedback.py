"""One sync read a tick: the feedback of all servos, when it was measured, and what it says of their health.

What is read is gathered into one block by indirect addressing. Beside current, velocity and position the
block holds torque enable, hardware error status and bus watchdog. A servo that has restarted has lost its
indirect addresses and shows zeros, so its watchdog differs from the one that was set.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Final, NamedTuple

from robot_io.clock import Clock
from robot_io.drivers.dynamixel import protocol
from robot_io.drivers.dynamixel.protocol import FastReply, StatusPacket, StatusReader
from robot_io.drivers.dynamixel.tables import (
    BUS_WATCHDOG,
    HARDWARE_ERROR_STATUS,
    PRESENT_CURRENT,
    PRESENT_POSITION,
    PRESENT_VELOCITY,
    TORQUE_ENABLE,
    WATCHDOG_FIRED,
    hardware_error_names,
)
from robot_io.errors import DeviceTimeoutError, ProtocolError
from robot_io.serial_port import SerialPort

_REGISTERS: Final = (
    TORQUE_ENABLE,
    HARDWARE_ERROR_STATUS,
    BUS_WATCHDOG,
    PRESENT_CURRENT,
    PRESENT_VELOCITY,
    PRESENT_POSITION,
)
_FORMAT: Final = struct.Struct("<BBbhii")
FEEDBACK_SIZE: Final = _FORMAT.size
PADDING: Final = 3  # bytes before the block, see `block_addresses`

_STATUS_PACKET = 11  # bytes around the data
_LARGEST_ANSWER = _STATUS_PACKET + 4 * (FEEDBACK_SIZE + PADDING) // 3 + 1  # bytes, every third one stuffed
_LATEST_S = 0.1  # no answer comes later than this after its request: USB adapters hold bytes for 16 ms


class Feedback(NamedTuple):
    """One servo's state, in its own units."""

    torque_on: int
    hardware_error: int
    watchdog: int  # -1 when it has fired
    current: int
    velocity: int
    position: int  # over several turns
    alert: bool  # whether its answer carried the alert bit


def block_addresses() -> tuple[int, ...]:
    """The addresses that the indirect data must stand for, in order.

    Some padding comes first: a request can start at any of its bytes, so that answers to different requests
    differ in length and a late one is told from a new one.
    """
    block = [register.address + byte for register in _REGISTERS for byte in range(register.size)]
    return (*[TORQUE_ENABLE.address] * PADDING, *block)


def decode_feedback(packet: StatusPacket) -> Feedback:
    """The block at the end of an answer. ProtocolError: the servo refused, or the answer is too short."""
    if packet.refusal:
        raise ProtocolError(f"servo {packet.servo_id} refuses to be read: {packet.refusal}")
    if len(packet.data) < FEEDBACK_SIZE:
        raise ProtocolError(f"servo {packet.servo_id} answered {len(packet.data)} bytes, too few")
    values: tuple[int, int, int, int, int, int] = _FORMAT.unpack(packet.data[-FEEDBACK_SIZE:])
    return Feedback(*values, packet.alert)


@dataclass(slots=True)
class _Request:
    """A way to ask. `asked_at_s` is when it was sent, None once it is answered [s]."""

    packet: bytes
    reply: FastReply
    asked_at_s: float | None = None
    answers: dict[int, StatusPacket] = field(default_factory=dict)


class FeedbackReader:
    """Asks for the feedback of all servos at once, and dates each answer by the request that it belongs to.

    The protocol has no sequence numbers, but answers differ in length by the number of padding bytes asked
    for. So the next request differs in length from all that are not answered yet: an answer that comes ticks
    late is as old as its request, and never passes for the newest. When every length is taken, nothing is
    asked until an answer comes or the oldest request is 0.1 s old.

    Args:
        port: an open port.
        clock: what deadlines are on.
        servo_ids: in the order of the joints.
        indirect_data: address where the padding starts.
        fast: whether the servos know the fast sync read.
    """

    def __init__(
        self, port: SerialPort, clock: Clock, servo_ids: Sequence[int], indirect_data: int, *, fast: bool
    ) -> None:
        self._port, self._clock, self._ids, self._fast = port, clock, tuple(servo_ids), fast
        ask = protocol.fast_sync_read if fast else protocol.sync_read
        sizes = range(FEEDBACK_SIZE, FEEDBACK_SIZE + PADDING + 1)
        self._requests = {
            size: _Request(
                ask(indirect_data + PADDING + FEEDBACK_SIZE - size, size, self._ids),
                FastReply(self._ids, size),
            )
            for size in sizes
        }
        self._by_length = {request.reply.length: request for request in self._requests.values()}
        self._in_turn = list(self._requests.values())  # the first one is next
        self._buffer = b""  # of fast answers
        self._packets = StatusReader(_LARGEST_ANSWER)
        self._asked = self._in_turn[0]
        self._problem = ""

    @property
    def byte_count(self) -> int:
        """Bytes of one request and its answers, nothing stuffed."""
        request = self._requests[FEEDBACK_SIZE]
        answers = request.reply.size if self._fast else len(self._ids) * (_STATUS_PACKET + FEEDBACK_SIZE)
        return len(request.packet) + answers

    def read(self, deadline_s: float) -> tuple[list[Feedback], float]:
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

    def _ask(self) -> _Request | None:
        """Send the next request whose length no unanswered one has."""
        now_s = self._clock.now_s()
        for request in self._in_turn:
            if request.asked_at_s is None or now_s - request.asked_at_s > _LATEST_S:
                request.asked_at_s, request.answers = now_s, {}
                self._port.write(request.packet)
                return request
        return None

    def _newest(self, data: bytes) -> tuple[list[Feedback], float] | None:
        """The last complete answer that ends in `data`, and when it was asked for [s]."""
        newest = None
        for request, packets in self._fast_answers(data) if self._fast else self._answers(data):
            if request.asked_at_s is None:
                continue  # a second answer
            try:
                newest = [decode_feedback(packet) for packet in packets], request.asked_at_s
            except ProtocolError as error:
                self._problem = str(error)
            self._forget_up_to(request.asked_at_s)
        return newest

    def _forget_up_to(self, asked_at_s: float) -> None:
        """Answers come in the order of the requests: those to this one and to earlier ones are over."""
        for request in self._in_turn:
            if request.asked_at_s is not None and request.asked_at_s <= asked_at_s:
                request.asked_at_s = None

    def _oldest_open(self, servo_id: int | None = None) -> _Request | None:
        """The first request that is not answered, by this servo if one is given.

        An answer whose length says nothing, damaged or a refusal, belongs to this one or a later one.
        """
        still_open = [
            (request.asked_at_s, size)
            for size, request in self._requests.items()
            if request.asked_at_s is not None and servo_id not in request.answers
        ]
        return self._requests[min(still_open)[1]] if still_open else None

    def _fast_answers(self, data: bytes) -> Iterator[tuple[_Request, list[StatusPacket]]]:
        self._buffer = buffer = self._buffer + data
        place, incomplete = 0, -1
        while (start := buffer.find(protocol.FAST_HEADER, place)) >= 0:
            place = start + 1
            request = self._by_length.get(buffer[start + 5 : start + 7])
            if len(buffer) >= start + 7 and request is None:
                continue
            if request is None or start + request.reply.size > len(buffer):
                incomplete = start if incomplete < 0 else incomplete
                continue
            end = start + request.reply.size
            try:
                packets = request.reply.decode(buffer[start:end])
            except ProtocolError as error:
                if buffer.find(protocol.FAST_HEADER, place, end) < 0:  # else the next one broke it off
                    self._problem = str(error)
                    damaged = self._oldest_open()  # its length may be what was damaged
                    if damaged is not None:
                        damaged.asked_at_s = None
                continue
            yield request, packets
            place, incomplete = end, -1
        if incomplete < 0:
            incomplete = max(place, len(buffer) - len(protocol.FAST_HEADER) + 1)
        self._buffer = buffer[incomplete:]

    def _answers(self, data: bytes) -> Iterator[tuple[_Request, list[StatusPacket]]]:
        for packet in self._packets.feed(data):
            request = self._requests.get(len(packet.data))
            if packet.refusal is not None:
                request = self._oldest_open(packet.servo_id)
            if request is not None and packet.servo_id in self._ids:
                request.answers[packet.servo_id] = packet
                if len(request.answers) == len(self._ids):
                    yield request, [request.answers[servo_id] for servo_id in self._ids]

    def _silence(self, asked: _Request) -> str:
        if self._fast:
            part = self._buffer[max(self._buffer.rfind(protocol.FAST_HEADER), 0) :]
            return f"servo {self._ids[asked.reply.answered(part)]} did not answer in time"
        silent = ", ".join(str(servo_id) for servo_id in self._ids if servo_id not in asked.answers)
        damaged = f" ({self._packets.rejected} damaged answers)" if self._packets.rejected else ""
        return f"servo {silent} did not answer in time{damaged}"


def feedback_problem(
    feedback: Sequence[Feedback], servo_ids: Sequence[int], watchdog: int, *, powered: bool
) -> str | None:
    """Why some of the feedback of all servos cannot be trusted, or None.

    Args:
        feedback: of all servos.
        servo_ids: their ids.
        watchdog: the value to which the bus watchdog was set.
        powered: whether the torque was switched on.
    """
    for joint, (servo_id, servo) in enumerate(zip(servo_ids, feedback, strict=True), 1):
        where = f"servo {servo_id} (joint {joint})"
        fired = servo.watchdog == WATCHDOG_FIRED
        if powered and fired:
            return f"{where}: its bus watchdog has fired, its torque is off"
        if servo.watchdog != watchdog and not fired:
            return f"{where}: has lost its settings; it has restarted"
        if powered and not servo.torque_on:
            names = hardware_error_names(servo.hardware_error)
            return f"{where}: has switched its torque off (hardware error: {names})"
    return None


def hardware_problem(feedback: Sequence[Feedback], servo_ids: Sequence[int]) -> str | None:
    """The hardware errors of all servos, by name, or None."""
    problems = [
        f"servo {servo_id} (joint {joint}): hardware error: {hardware_error_names(servo.hardware_error)}"
        for joint, (servo_id, servo) in enumerate(zip(servo_ids, feedback, strict=True), 1)
        if servo.alert or servo.hardware_error
    ]
    return "; ".join(problems) or None
