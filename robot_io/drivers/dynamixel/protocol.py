"""Dynamixel Protocol 2.0 as bytes: packets, instructions, CRC and the fast sync read; no ports, no clocks.

A packet is FF FF FD 00, id, length (2 bytes, little-endian), instruction, parameters, CRC (2 bytes). The
length counts everything after itself. Between length and CRC, FF FF FD is followed by an extra FD (byte
stuffing), so that a header occurs nowhere else; length and CRC are made with the stuffing in place. A status
packet has the instruction 55 and an error byte before its parameters. Source: ROBOTIS e-manual, "DYNAMIXEL
Protocol 2.0" and "CRC Calculation".
"""

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from palpate.robot_io.drivers.servo.stream import (
    BROADCAST_ID,
    LARGEST_ID,
    SYNC_WRITE,
    PacketStream,
    ServoAnswer,
    ServoProtocol,
)
from palpate.robot_io.errors import ProtocolError

_POLYNOMIAL = 0x8005


def _table_entry(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = (value << 1) ^ (_POLYNOMIAL if value & 0x8000 else 0)
    return value & 0xFFFF


_TABLE = tuple(map(_table_entry, range(256)))
_OF_WORDS = [(entry << 8) & 0xFF00 ^ _TABLE[entry >> 8] ^ low for entry in _TABLE for low in _TABLE]


def crc16(data: bytes, start: int = 0) -> int:
    """Compute the CRC-16 of `data`, from 0 to FFFF, two bytes at a time.

    Args:
        data: Bytes that it covers.
        start: Checksum of the bytes before `data`.
    """
    crc, word_table, count = start, _OF_WORDS, len(data) // 2
    for word in struct.unpack_from(f">{count}H", data):
        crc = word_table[crc ^ word]
    if len(data) > 2 * count:
        crc = (crc << 8) & 0xFF00 ^ _TABLE[crc >> 8 ^ data[-1]]
    return crc


def _checksum(data: bytes, start: int = 0) -> bytes:
    return crc16(data, start).to_bytes(_CRC, "little")


HEADER: Final = b"\xff\xff\xfd\x00"
LARGEST_PACKET: Final = 1024  # bytes; far more than any reply to what this package asks

_STATUS = 0x55
_HEAD = 7  # bytes up to and with the length
_CRC = 2
_LEAST_STATUS_LENGTH = 4  # instruction, error, checksum
_LAST_BEFORE_STUFFING, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_ALERT = 0x80

_ERROR_NAMES = {
    1: "it failed to process the instruction",
    2: "it does not support the instruction",
    3: "the instruction arrived damaged",
    4: "the value is out of range",
    5: "the data is too short for the register",
    6: "the value is beyond the configured limit",
    7: "the register cannot be accessed now",
}


class DynamixelStatus(ServoAnswer):
    """Answer of a servo. Bit 7 of its error byte is the alert of a hardware error, the rest a number."""

    __slots__ = ()

    @property
    def alert(self) -> bool:
        return self.error >= _ALERT

    @property
    def refusal(self) -> str | None:
        number = self.error & ~_ALERT
        return _ERROR_NAMES.get(number, f"error number {number}") if number else None


def decode_status(packet: bytes) -> DynamixelStatus:
    """Decode sender, error and parameters; raise `ProtocolError` if damaged, or not a status packet.

    Args:
        packet: The whole packet and nothing else.
    """
    if len(packet) < _HEAD + _LEAST_STATUS_LENGTH or not packet.startswith(HEADER):
        raise ProtocolError(f"not a packet: {packet[:16].hex(' ')}")
    servo_id, length = packet[4], packet[5] | packet[6] << 8
    if length != len(packet) - _HEAD:
        raise ProtocolError(f"a packet of {len(packet)} bytes whose length field says {_HEAD + length}")
    if packet[-_CRC:] != _checksum(packet[:-_CRC]):
        raise ProtocolError(f"CRC mismatch in a packet of servo {servo_id}")
    if packet[_HEAD] != _STATUS or servo_id > LARGEST_ID:
        raise ProtocolError(f"not an answer from a servo: id {servo_id}, instruction {packet[_HEAD]:#04x}")
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


PING_SIZE: Final = 3  # bytes of the answer to a ping: model number (2) and firmware version
_FAST_SYNC_READ = 0x8A


class DynamixelProtocol(ServoProtocol):
    """See `ServoProtocol`; an echo is not a status packet."""

    word = 2

    def _packet(self, servo_id: int, instruction: int, parameters: bytes) -> bytes:
        body = (bytes((instruction,)) + parameters).replace(_LAST_BEFORE_STUFFING, _STUFFED)
        length = len(body) + _CRC
        if _HEAD + length > LARGEST_PACKET:
            raise ProtocolError(f"a packet of {_HEAD + length} bytes exceeds the limit of {LARGEST_PACKET}")
        packet = HEADER + bytes((servo_id, length & 0xFF, length >> 8)) + body
        return packet + _checksum(packet)

    def fast_sync_read(self, address: int, size: int, servo_ids: Sequence[int]) -> bytes:
        """Read the same bytes of several servos, which answer with one joint packet; see `FastReply`.

        Args:
            address: address of the first byte.
            size: number of bytes from each servo.
            servo_ids: in the order of their parts.
        """
        return self.encode_packet(BROADCAST_ID, _FAST_SYNC_READ, self.words(address, size) + bytes(servo_ids))

    def sync_write_block(self, address: int, size: int, block: bytes) -> bytes:
        if _LAST_BEFORE_STUFFING in block:
            return self.encode_packet(BROADCAST_ID, SYNC_WRITE, self.words(address, size) + block)
        head, crc = self._sync_write_head(address, size, len(block))
        return head + block + _checksum(block, crc)

    @lru_cache  # noqa: B019 -- there is one dialect
    def _sync_write_head(self, address: int, size: int, count: int) -> tuple[bytes, int]:
        """Return the bytes before `count` bytes of a sync write that need no stuffing, and their checksum."""
        packet = self.encode_packet(BROADCAST_ID, SYNC_WRITE, self.words(address, size) + bytes(count))
        head = packet[: len(packet) - count - _CRC]
        return head, crc16(head)

    def packet_reader(self, request: bytes) -> DynamixelStatusReader:
        return DynamixelStatusReader()


DIALECT: Final = DynamixelProtocol()


FAST_HEADER: Final = HEADER + bytes((BROADCAST_ID,))
_FAST_HEAD = 8  # bytes before the first servo's part
_AROUND_DATA = 4  # error, id and checksum of a part


class FastReply:
    """Form of the answer to one fast sync read.

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
        self.length = (self.size - _HEAD).to_bytes(2, "little")
        self._head = FAST_HEADER + self.length + bytes((_STATUS,))
        self._no_errors = bytes(len(self._ids))
        starts = range(_FAST_HEAD, self.size, self._part)
        self._data = [slice(start + 2, start + self._part - _CRC) for start in starts]

    def answered(self, data: bytes) -> int:
        """Count the servos that have added their part to an answer that is not complete.

        Args:
            data: bytes received so far.
        """
        return min(max(0, (len(data) - _FAST_HEAD) // self._part), len(self._ids) - 1)

    def valid_parts(self, data: bytes) -> bytes | None:
        """Return the parts of all servos: error, id, data and checksum of each.

        Args:
            data: received bytes.

        Returns:
            The parts one after the other; None if the bytes are not just the whole answer, undamaged and
            without an error of a servo, see `decode`.
        """
        is_valid = (
            len(data) == self.size
            and data.startswith(self._head)
            and data[_FAST_HEAD :: self._part] == self._no_errors
            and data[_FAST_HEAD + 1 :: self._part] == self._ids
            and data[-_CRC:] == _checksum(data[:-_CRC])
        )
        return data[_FAST_HEAD:] if is_valid else None

    def decode(self, packet: bytes) -> list[DynamixelStatus]:
        """Split a whole answer into the servos' parts, in the order in which they were asked.

        Args:
            packet: The whole packet and nothing else.

        Raises:
            ProtocolError: It is not such an answer, a checksum is wrong, or a part is another servo's.
        """
        if len(packet) != self.size or not packet.startswith(self._head):
            raise ProtocolError(f"not the answer to a fast sync read: {packet[:16].hex(' ')}")
        if packet[-_CRC:] != _checksum(packet[:-_CRC]):
            # The first mismatch shows whose part it is; the last checksum covers all parts.
            ends = zip(self._ids, range(_FAST_HEAD + self._part, self.size, self._part), strict=False)
            damaged = (i for i, end in ends if packet[end - 2 : end] != _checksum(packet[: end - 2]))
            raise ProtocolError(
                f"CRC mismatch in servo {next(damaged, self._ids[-1])}'s part of a fast sync read"
            )
        errors, ids = packet[_FAST_HEAD :: self._part], packet[_FAST_HEAD + 1 :: self._part]
        if ids != self._ids:
            answered, asked = next(pair for pair in zip(ids, self._ids, strict=True) if pair[0] != pair[1])
            raise ProtocolError(f"servo {answered} answered in place of servo {asked}")
        return list(map(DynamixelStatus, ids, errors, map(packet.__getitem__, self._data)))
