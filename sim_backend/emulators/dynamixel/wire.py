"""The servo's side of Dynamixel Protocol 2.0: bytes to instructions, answers to bytes.

Written from the ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0" (packet structure, processing order of reception
and transmission, Fast Sync Read) and "CRC Calculation"; it shares no code with the driver.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

STATUS_INSTRUCTION = 0x55
BROADCAST = 0xFE
_START = bytes((0xFF, 0xFF, 0xFD))
_STUFFING = 0xFD
_STUFFED = bytes((*_START, _STUFFING))
_TOO_LONG = 0x3FF  # no servo takes more


@dataclass(frozen=True)
class Instruction:
    """An instruction packet as a servo has understood it."""

    target: int  # id of the servo, or `BROADCAST`
    code: int  # what to do
    parameters: bytes  # with what, stuffing removed
    intact: bool  # whether the checksum was right
    wire_bytes: int  # bytes that it took on the wire


def checksum(data: bytes) -> int:
    """Divide by x^16 + x^15 + x^2 + 1, most significant bit first, remainder 0 at the start."""
    remainder = 0
    for byte in data:
        remainder = (remainder << 8 & 0xFFFF) ^ _QUOTIENTS[remainder >> 8 ^ byte]
    return remainder


def _divide(byte: int) -> int:
    remainder = byte << 8
    for _ in range(8):
        carry = remainder >> 15
        remainder = (remainder << 1) & 0xFFFF
        if carry:
            remainder ^= 0x8005
    return remainder


_QUOTIENTS = [_divide(byte) for byte in range(256)]


class Receiver:
    """Picks instructions out of what comes over the wire."""

    def __init__(self) -> None:
        self._pending = bytearray()

    def take(self, data: bytes) -> Iterator[Instruction]:
        """The instructions that are complete with `data`."""
        self._pending += data
        while (instruction := self._next()) is not None:
            yield instruction

    def _next(self) -> Instruction | None:
        pending = self._pending
        while True:
            begin = pending.find(_START)
            if begin < 0:
                del pending[: max(0, len(pending) - 2)]
                return None
            del pending[:begin]
            if len(pending) < 7:
                return None
            length = pending[5] + 256 * pending[6]
            if pending[3] == _STUFFING or not 3 <= length <= _TOO_LONG:
                del pending[:3]  # stuffed data, or noise that looked like a start
                continue
            if len(pending) < 7 + length:
                return None
            packet = bytes(pending[: 7 + length])
            del pending[: 7 + length]
            return _understand(packet)


def _understand(packet: bytes) -> Instruction:
    sent = packet[-2] + 256 * packet[-1]
    body = packet[7:-2].replace(_STUFFED, _START)
    intact = checksum(packet[:-2]) == sent
    return Instruction(packet[4], body[0], body[1:], intact, len(packet))


def status(servo_id: int, error: int, data: bytes = b"") -> bytes:
    """A status packet."""
    body = (bytes((STATUS_INSTRUCTION, error)) + data).replace(_START, _STUFFED)
    length = len(body) + 2
    packet = _START + bytes((0, servo_id, length % 256, length // 256)) + body
    return packet + _little(checksum(packet))


def fast_status(parts: Sequence[tuple[int, int, bytes]], asked: int) -> bytes:
    """What servos make together of a fast sync read.

    The parts are id, error and data of those that answer; the chain ends where one is silent, but the head
    promises the answer of all that were asked.
    """
    each = len(parts[0][2]) + 4
    length = 1 + asked * each
    packet = _START + bytes((0, BROADCAST, length % 256, length // 256, STATUS_INSTRUCTION))
    for servo_id, error, data in parts:
        packet += bytes((error, servo_id)) + data
        packet += _little(checksum(packet))
    return packet


def _little(value: int) -> bytes:
    return bytes((value % 256, value // 256))
