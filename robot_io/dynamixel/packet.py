"""Packets of Dynamixel Protocol 2.0 as bytes: pure functions, no ports and no clocks.

A packet is FF FF FD 00, id, length (2 bytes, little-endian), instruction, parameters, checksum (2 bytes). The
length counts everything after itself. Between length and checksum, FF FF FD is followed by an extra FD, so
that a header occurs nowhere else; length and checksum are made with these extra bytes in place. A status
packet has the instruction 55 and an error byte before its parameters.
Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0".
"""

from typing import Final, NamedTuple

from robot_io.dynamixel.crc import crc16
from robot_io.errors import ProtocolError

HEADER: Final = b"\xff\xff\xfd\x00"
LARGEST_ID: Final = 0xFC
BROADCAST_ID: Final = 0xFE
LARGEST_PACKET: Final = 1024  # bytes; far more than any reply to what this package asks

_STATUS = 0x55
_HEAD = 7  # bytes up to and with the length
_CRC = 2
_LEAST_STATUS_LENGTH = 4  # instruction, error, checksum
_LAST_BEFORE_STUFFING, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_ALERT = 0x80

_ERROR_NAMES = {
    1: "it failed to process the instruction",
    2: "it does not know the instruction",
    3: "the instruction arrived damaged",
    4: "the value is out of range",
    5: "the data is too short for the register",
    6: "the value is beyond the configured limit",
    7: "the register cannot be accessed now",
}


class StatusPacket(NamedTuple):
    """What a servo answers.

    Attributes:
        servo_id: who answers.
        error: error byte: bit 7 is the alert, the rest an error number.
        data: parameters.
    """

    servo_id: int
    error: int
    data: bytes

    @property
    def alert(self) -> bool:
        """Whether the servo has a hardware error."""
        return bool(self.error & _ALERT)

    @property
    def refusal(self) -> str | None:
        """Why the instruction was refused, or None if it was not."""
        number = self.error & ~_ALERT
        return _ERROR_NAMES.get(number, f"error number {number}") if number else None


def encode_packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """The instruction packet for a servo, or for all with `BROADCAST_ID`.

    Raises:
        ProtocolError: no servo can have this id, or the packet would be too long.
    """
    if not (0 <= servo_id <= LARGEST_ID or servo_id == BROADCAST_ID):
        raise ProtocolError(f"{servo_id} is no servo id: 0 to {LARGEST_ID}, or {BROADCAST_ID} for all")
    body = bytes((instruction,)) + parameters
    body = body.replace(_LAST_BEFORE_STUFFING, _STUFFED)
    length = len(body) + _CRC
    if _HEAD + length > LARGEST_PACKET:
        raise ProtocolError(f"a packet of {_HEAD + length} bytes is too long, at most {LARGEST_PACKET}")
    packet = HEADER + bytes((servo_id, length & 0xFF, length >> 8)) + body
    return packet + crc16(packet).to_bytes(_CRC, "little")


def decode_status(packet: bytes) -> StatusPacket:
    """The status packet that `packet` is, no more and no less.

    Raises:
        ProtocolError: it is not one, or its checksum is wrong.
    """
    if len(packet) < _HEAD + _LEAST_STATUS_LENGTH or not packet.startswith(HEADER):
        raise ProtocolError(f"not a packet: {packet[:16].hex(' ')}")
    servo_id, length = packet[4], packet[5] | packet[6] << 8
    if length != len(packet) - _HEAD:
        raise ProtocolError(f"a packet of {len(packet)} bytes that says {_HEAD + length}")
    if crc16(packet[:-_CRC]) != packet[-2] | packet[-1] << 8:
        raise ProtocolError(f"wrong checksum in a packet of servo {servo_id}")
    if packet[_HEAD] != _STATUS or servo_id > LARGEST_ID:
        raise ProtocolError(f"not an answer of a servo: id {servo_id}, instruction {packet[_HEAD]:#04x}")
    body = packet[_HEAD + 1 : -_CRC].replace(_STUFFED, _LAST_BEFORE_STUFFING)
    return StatusPacket(servo_id, body[0], body[1:])


class StatusReader:
    """Finds status packets in a stream of bytes that comes in pieces and may be damaged anywhere.

    Args:
        largest: no expected packet has more bytes; a damaged length is not waited for.

    Attributes:
        rejected: how many things looked like a packet and were none.
    """

    def __init__(self, largest: int = LARGEST_PACKET) -> None:
        self._largest = largest
        self._buffer = b""
        self.rejected = 0

    def feed(self, data: bytes) -> list[StatusPacket]:
        """Take more bytes; return the packets that are complete now."""
        buffer = self._buffer + data
        found: list[StatusPacket] = []
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                self._buffer = buffer[-(len(HEADER) - 1) :]
                return found
            buffer = buffer[start:]
            if len(buffer) < _HEAD:
                break
            size = _HEAD + (buffer[5] | buffer[6] << 8)
            if len(buffer) < size <= self._largest:
                break
            buffer = self._take(buffer, size, found)
        self._buffer = buffer
        return found

    def _take(self, buffer: bytes, size: int, found: list[StatusPacket]) -> bytes:
        try:
            found.append(decode_status(buffer[:size]))
        except ProtocolError:
            self.rejected += 1
            return buffer[1:]  # the true header may lie within
        return buffer[size:]
