"""One sync read a tick: the feedback of all servos, when it was measured, and what it says of their health.

What is read is gathered into one block by indirect addressing. Beside current, velocity and position the
block holds torque enable, hardware error status and bus watchdog. A servo that has restarted has lost its
indirect addresses and shows zeros, so its watchdog differs from the one that was set.
"""

import struct
from collections.abc import Iterator, Sequence
from functools import cached_property
from math import inf
from typing import Final, NamedTuple

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.dynamixel import protocol
from palpate.robot_io.drivers.dynamixel.protocol import DynamixelStatus, DynamixelStatusReader, FastReply
from palpate.robot_io.drivers.dynamixel.tables import (
    BUS_WATCHDOG,
    HARDWARE_ERROR_STATUS,
    PRESENT_CURRENT,
    PRESENT_POSITION,
    PRESENT_VELOCITY,
    TORQUE_ENABLE,
    WATCHDOG_FIRED,
    hardware_error_names,
)
from palpate.robot_io.drivers.servo.feedback import FeedbackReader, Request
from palpate.robot_io.errors import ProtocolError
from palpate.robot_io.serial_port import SerialPort

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


class DynamixelFeedback(NamedTuple):
    """One servo's state, in its own units."""

    error: int  # error byte of its answer: 0, or the alert
    torque_on: int
    hardware_error: int
    watchdog: int  # -1 when it has fired
    current: int
    velocity: int
    position: int  # over several turns

    @property
    def complaint(self) -> str:
        """Its hardware errors by name, or nothing."""
        is_well = not (self.error or self.hardware_error)
        return "" if is_well else f"hardware error: {hardware_error_names(self.hardware_error)}"


def block_addresses() -> tuple[int, ...]:
    """List the addresses that the indirect data must stand for, in order.

    Some padding comes first: a request can start at any of its bytes, so that answers to different requests
    differ in length and a late one is told from a new one.
    """
    block = [register.address + byte for register in _REGISTERS for byte in range(register.size)]
    return (*[TORQUE_ENABLE.address] * PADDING, *block)


def decode_feedback(packet: DynamixelStatus) -> DynamixelFeedback:
    """Decode the block at the end of an answer.

    Args:
        packet: An answer of at least `FEEDBACK_SIZE` bytes.

    Raises:
        ProtocolError: The servo refused to be read.
    """
    servo_id, error, data = packet
    if error and packet.refusal:
        raise ProtocolError(f"servo {servo_id} refuses to be read: {packet.refusal}")
    return DynamixelFeedback(error, *_FORMAT.unpack_from(data, len(data) - FEEDBACK_SIZE))


def feedback_reader(
    port: SerialPort, clock: Clock, servo_ids: Sequence[int], indirect_data: int, *, fast: bool
) -> FeedbackReader[DynamixelFeedback]:
    """Make the reader of the block of all servos.

    Args:
        port: An open port.
        clock: Clock of the deadlines.
        servo_ids: Servos that are asked, in this order.
        indirect_data: Address where the padding starts.
        fast: Whether the servos know the fast sync read.
    """
    ids = tuple(servo_ids)
    ask = protocol.DIALECT.fast_sync_read if fast else protocol.DIALECT.sync_read
    sizes = range(FEEDBACK_SIZE, FEEDBACK_SIZE + PADDING + 1)
    return (_FastReader if fast else FeedbackReader)(
        port,
        clock,
        ids,
        asking={size: ask(indirect_data + PADDING + FEEDBACK_SIZE - size, size, ids) for size in sizes},
        packets=DynamixelStatusReader(_LARGEST_ANSWER),
        decode=decode_feedback,
        around=_STATUS_PACKET,
    )


class _FastReader(FeedbackReader[DynamixelFeedback]):
    """The servos make one packet together; its length says at once which request it answers."""

    _buffer = b""

    @cached_property
    def _replies(self) -> dict[int, FastReply]:
        return {size: FastReply(self._ids, size) for size in self._requests}

    @cached_property
    def _by_length(self) -> dict[bytes, Request]:
        return {self._replies[size].length: request for size, request in self._requests.items()}

    def _answer_size(self, size: int) -> int:
        return self._replies[size].size

    def _answers(self, data: bytes) -> Iterator[tuple[Request, Sequence[DynamixelStatus]]]:
        self._buffer = buffer = self._buffer + data
        place, incomplete = 0, -1
        while (start := buffer.find(protocol.FAST_HEADER, place)) >= 0:
            place = start + 1
            request = self._by_length.get(buffer[start + 5 : start + 7])
            if len(buffer) >= start + 7 and request is None:
                continue
            if request is None or start + self._answer_size(request.size) > len(buffer):
                incomplete = start if incomplete < 0 else incomplete
                continue
            end = start + self._answer_size(request.size)
            try:
                packets = self._replies[request.size].decode(buffer[start:end])
            except ProtocolError as error:
                if buffer.find(protocol.FAST_HEADER, place, end) < 0:  # else the next one broke it off
                    self._problem = str(error)
                    damaged = self._oldest_open()  # its length may be what was damaged
                    if damaged is not None:
                        damaged.asked_at_s = -inf
                continue
            yield request, packets
            place, incomplete = end, -1
        if incomplete < 0:
            incomplete = max(place, len(buffer) - len(protocol.FAST_HEADER) + 1)
        self._buffer = buffer[incomplete:]

    def _silence(self, asked: Request) -> str:
        part = self._buffer[max(self._buffer.rfind(protocol.FAST_HEADER), 0) :]
        return f"servo {self._ids[self._replies[asked.size].answered(part)]} did not answer in time"


def feedback_problem(
    feedback: Sequence[DynamixelFeedback], labels: Sequence[str], watchdog: int, *, powered: bool
) -> str | None:
    """Say why some of the feedback cannot be trusted, or None.

    Args:
        feedback: Feedback of all servos.
        labels: What to call them, in the same order.
        watchdog: What the bus watchdog was set to.
        powered: Whether the torque was switched on.
    """
    for label, servo in zip(labels, feedback, strict=True):
        has_fired = servo.watchdog == WATCHDOG_FIRED
        if powered and has_fired:
            return f"{label}: its bus watchdog has fired, its torque is off"
        if servo.watchdog != watchdog and not has_fired:
            return f"{label}: has lost its settings; it has restarted"
        if powered and not servo.torque_on:
            names = hardware_error_names(servo.hardware_error)
            return f"{label}: has switched its torque off (hardware error: {names})"
    return None
