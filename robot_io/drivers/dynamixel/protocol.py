"""Dynamixel Protocol 2.0 as bytes: packets, instructions, CRC and the fast sync read; no ports, no clocks.

A packet is FF FF FD 00, id, length (2 bytes, little-endian), instruction, parameters, CRC (2 bytes). The
length counts everything after itself. Between length and CRC, FF FF FD is followed by an extra FD (byte
stuffing), so that a header occurs nowhere else; length and CRC are made with the stuffing in place. A status
packet has the instruction 55 and an error byte before its parameters. Source: ROBOTIS e-manual, "DYNAMIXEL
Protocol 2.0" and "CRC Calculation".
"""

import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

from palpate.robot_io.drivers.servo.stream import PacketStream, equal_parts
from palpate.robot_io.errors import ProtocolError

_POLYNOMIAL = 0x8005


def _table_entry(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = (value << 1) ^ (_POLYNOMIAL if value & 0x8000 else 0)
    return value & 0xFFFF


_TABLE = tuple(map(_table_entry, range(256)))
_TABLE_BEFORE = tuple((entry << 8) & 0xFF00 ^ _TABLE[entry >> 8] for entry in _TABLE)  # one byte earlier


def crc16(data: bytes, start: int = 0) -> int:
    """Compute the checksum of `data`, two bytes at a time.

    Args:
        data: Bytes that it covers.
        start: Checksum of what came before `data`.
    """
    crc, table, before, count = start, _TABLE, _TABLE_BEFORE, len(data) // 2
    for word in struct.unpack_from(f">{count}H", data):
        crc ^= word
        crc = before[crc >> 8] ^ table[crc & 0xFF]
    if len(data) > 2 * count:
        crc = (crc << 8) & 0xFF00 ^ _TABLE[crc >> 8 ^ data[-1]]
    return crc


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


class DynamixelStatus(NamedTuple):
    """What a servo answers."""

    servo_id: int  # who answers
    error: int  # error byte: bit 7 is the alert, the rest an error number
    data: bytes  # parameters

    @property
    def alert(self) -> bool:
        """Whether the servo has a hardware error."""
        return self.error >= _ALERT

    @property
    def refusal(self) -> str | None:
        """Why the instruction was refused, or None if it was not."""
        number = self.error & ~_ALERT
        return _ERROR_NAMES.get(number, f"error number {number}") if number else None


def encode_packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Encode an instruction packet.

    Args:
        servo_id: Servo that is addressed, or `BROADCAST_ID` for all.
        instruction: Code of the instruction.
        parameters: Its parameters, not stuffed.

    Raises:
        ProtocolError: No servo can have this id, or the packet would be too long.
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


def decode_status(packet: bytes) -> DynamixelStatus:
    """Decode a status packet.

    Args:
        packet: The whole packet and nothing else.

    Raises:
        ProtocolError: It is no status packet, or its checksum is wrong.
    """
    if len(packet) < _HEAD + _LEAST_STATUS_LENGTH or not packet.startswith(HEADER):
        raise ProtocolError(f"not a packet: {packet[:16].hex(' ')}")
    servo_id, length = packet[4], packet[5] | packet[6] << 8
    if length != len(packet) - _HEAD:
        raise ProtocolError(f"a packet of {len(packet)} bytes that says {_HEAD + length}")
    if crc16(packet[:-_CRC]) != packet[-2] | packet[-1] << 8:
        raise ProtocolError(f"CRC mismatch in a packet of servo {servo_id}")
    if packet[_HEAD] != _STATUS or servo_id > LARGEST_ID:
        raise ProtocolError(f"not an answer of a servo: id {servo_id}, instruction {packet[_HEAD]:#04x}")
    body = packet[_HEAD + 1 : -_CRC].replace(_STUFFED, _LAST_BEFORE_STUFFING)
    return DynamixelStatus(servo_id, body[0], body[1:])


class DynamixelStatusReader(PacketStream[DynamixelStatus]):
    """Finds status packets in a stream; see `PacketStream`."""

    header = HEADER
    head = _HEAD

    def __init__(self, largest: int = LARGEST_PACKET) -> None:
        super().__init__(largest)

    def _size(self, buffer: bytes, start: int) -> int:
        return _HEAD + (buffer[start + 5] | buffer[start + 6] << 8)

    def _decode(self, packet: bytes) -> DynamixelStatus:
        return decode_status(packet)


def packet_reader(request: bytes) -> DynamixelStatusReader:
    """Make what finds the answers to a request; its echo is no status packet.

    Args:
        request: packet that the servos were sent.
    """
    return DynamixelStatusReader()


_PING, _READ, _WRITE, _REBOOT = 0x01, 0x02, 0x03, 0x08
_SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x82, 0x83, 0x8A


PING_SIZE: Final = 3


def ping(servo_id: int) -> bytes:
    """Ask who a servo is: it answers with model number (2 bytes) and firmware version (1 byte).

    Args:
        servo_id: of the servo, or the broadcast id.
    """
    return encode_packet(servo_id, _PING)


def ping_all() -> bytes:
    """Ask who is on the line; each servo answers as to `ping`."""
    return ping(BROADCAST_ID)


def reboot(servo_id: int) -> bytes:
    """Restart a servo, which is the only way out of a hardware error.

    Args:
        servo_id: of the servo.
    """
    return encode_packet(servo_id, _REBOOT)


def read(servo_id: int, address: int, size: int) -> bytes:
    """Read `size` bytes at `address`.

    Args:
        servo_id: of the servo.
        address: of the first byte.
        size: number of bytes.
    """
    return encode_packet(servo_id, _READ, _word(address) + _word(size))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    """Write `data` at `address`; acknowledged with an empty answer.

    Args:
        servo_id: of the servo.
        address: of the first byte.
        data: the bytes.
    """
    return encode_packet(servo_id, _WRITE, _word(address) + data)


def sync_read(address: int, size: int, servo_ids: Sequence[int]) -> bytes:
    """Read the same bytes of several servos; each answers with a packet of its own, in this order.

    Args:
        address: of the first byte.
        size: number of bytes from each servo.
        servo_ids: in the order of the answers.
    """
    return encode_packet(BROADCAST_ID, _SYNC_READ, _word(address) + _word(size) + bytes(servo_ids))


def fast_sync_read(address: int, size: int, servo_ids: Sequence[int]) -> bytes:
    """Read the same bytes of several servos, which make one packet together; see `FastReply`.

    Args:
        address: of the first byte.
        size: number of bytes from each servo.
        servo_ids: in the order of their parts.
    """
    return encode_packet(BROADCAST_ID, _FAST_SYNC_READ, _word(address) + _word(size) + bytes(servo_ids))


def sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Write at the same address of several servos, each its own bytes; nobody answers.

    Args:
        address: Of the first byte.
        data: Bytes by servo id.

    Raises:
        ProtocolError: The bytes are not of equal number.
    """
    return sync_write_block(address, *equal_parts(data))


def sync_write_block(address: int, size: int, block: bytes) -> bytes:
    """Write at the same address of several servos; nobody answers.

    Args:
        address: Of the first byte.
        size: Number of bytes for each servo.
        block: For each servo its id and its bytes.
    """
    if _LAST_BEFORE_STUFFING in block:
        return encode_packet(BROADCAST_ID, _SYNC_WRITE, _word(address) + _word(size) + block)
    head, crc = _sync_write_head(address, size, len(block))
    return head + block + crc16(block, crc).to_bytes(_CRC, "little")


@lru_cache
def _sync_write_head(address: int, size: int, count: int) -> tuple[bytes, int]:
    """What comes before `count` bytes of a sync write that need no stuffing, and its checksum."""
    packet = encode_packet(BROADCAST_ID, _SYNC_WRITE, _word(address) + _word(size) + bytes(count))
    head = packet[: len(packet) - count - _CRC]
    return head, crc16(head)


def _word(value: int) -> bytes:
    return value.to_bytes(2, "little")


FAST_HEADER: Final = HEADER + bytes((BROADCAST_ID,))
_FAST_HEAD = 8  # bytes before the first servo's part
_AROUND_DATA = 4  # error, id and checksum of a part


class FastReply:
    """How the answer to one fast sync read must look.

    Args:
        servo_ids: Servos that were asked, in this order.
        data_size: Number of bytes that each was asked for.

    Attributes:
        size: Bytes of the whole answer.
        length: Its length field.
    """

    def __init__(self, servo_ids: Sequence[int], data_size: int) -> None:
        self._ids = bytes(servo_ids)
        self._part = data_size + _AROUND_DATA
        self.size = _FAST_HEAD + len(self._ids) * self._part
        self.length = _word(self.size - _HEAD)
        self._head = FAST_HEADER + self.length + bytes((_STATUS,))
        starts = range(_FAST_HEAD, self.size, self._part)
        self._data = [slice(start + 2, start + self._part - _CRC) for start in starts]

    def answered(self, data: bytes) -> int:
        """Count the servos that have added their part to an answer that is not complete.

        Args:
            data: what has been received so far.
        """
        return min(max(0, (len(data) - _FAST_HEAD) // self._part), len(self._ids) - 1)

    def decode(self, packet: bytes) -> list[DynamixelStatus]:
        """Split a whole answer.

        Args:
            packet: The whole packet and nothing else.

        Returns:
            Each servo's part, in the order in which they were asked.

        Raises:
            ProtocolError: It is not such an answer, a checksum is wrong, or a part is another servo's.
        """
        if len(packet) != self.size or not packet.startswith(self._head):
            raise ProtocolError(f"not the answer to a fast sync read: {packet[:16].hex(' ')}")
        if crc16(packet[:-_CRC]) != packet[-2] | packet[-1] << 8:
            raise ProtocolError(f"CRC mismatch in {self._damaged_part(packet)} part of a fast sync read")
        errors, ids = packet[_FAST_HEAD :: self._part], packet[_FAST_HEAD + 1 :: self._part]
        if ids != self._ids:
            answered, asked = next(pair for pair in zip(ids, self._ids, strict=True) if pair[0] != pair[1])
            raise ProtocolError(f"servo {answered} answered in place of servo {asked}")
        return list(map(DynamixelStatus, ids, errors, map(packet.__getitem__, self._data)))

    def _damaged_part(self, packet: bytes) -> str:
        """Whose part has the first CRC mismatch; the last one covers all, and is enough to accept."""
        ends = range(_FAST_HEAD + self._part, self.size, self._part)
        for servo_id, end in zip(self._ids, ends, strict=False):
            if crc16(packet[: end - 2]) != packet[end - 2] | packet[end - 1] << 8:
                return f"servo {servo_id}'s"
        return f"servo {self._ids[-1]}'s"
