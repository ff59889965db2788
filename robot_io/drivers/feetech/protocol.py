"""Feetech's serial servo protocol as bytes, which is close to Dynamixel Protocol 1.0; no ports, no clocks.

A packet is FF FF, id, length, instruction, parameters, checksum. The length counts everything after itself,
and the checksum is the inverted sum of everything after the header. A servo answers with an error byte in
place of the instruction, so that the echo of an instruction looks like an answer. STS servos are
little-endian. Source: Feetech, "Magnetic encoder smart servo communication protocol" (SMS/STS series).
"""

from collections.abc import Iterable
from functools import lru_cache, partial
from itertools import repeat
from typing import Final
from zlib import adler32

from palpate.robot_io.drivers.servo.stream import (
    BROADCAST_ID,
    LARGEST_ID,
    SYNC_WRITE,
    PacketStream,
    ServoAnswer,
    ServoProtocol,
    bit_names,
)
from palpate.robot_io.errors import ProtocolError

HEADER: Final = b"\xff\xff"
AROUND: Final = 6  # bytes of an answer around its data

_ID_ADDRESS = 5
WHOLE_SUM: Final = (sum(HEADER) + 0xFF) & 0xFF  # of a packet with its checksum, which inverts the rest
ID_SIZE: Final = 1  # bytes of the answer to `ping`
_LARGEST_LENGTH = 0xFA

ERROR_NAMES: Final = {
    0x01: "input voltage",
    0x02: "position sensor",
    0x04: "overheating",
    0x08: "over current",
    0x20: "overload",
}
error_names = partial(bit_names, names=ERROR_NAMES)  # of an answer's error byte, one bit an error


def _byte_sum(data: bytes, start: int = 0) -> int:
    """Sum at most 256 bytes, onto earlier ones: the low half of Adler-32, four times as fast as `sum`."""
    return adler32(data, start) & 0xFFFF


def are_intact(packets: Iterable[bytes]) -> bool:
    """Check whether the checksums of packets of at most 256 bytes are right.

    Args:
        packets: Whole packets and nothing else.
    """
    return {total & 0xFF for total in map(adler32, packets, repeat(0))} == {WHOLE_SUM}


def decode_status(packet: bytes) -> ServoAnswer:
    """Decode sender, error and parameters; raise `ProtocolError` if damaged, or not a status packet.

    Args:
        packet: The whole packet and nothing else.
    """
    size = len(packet)
    if size < AROUND or not packet.startswith(HEADER):
        raise ProtocolError(f"not a packet: {packet[:16].hex(' ')}")
    servo_id, length = packet[2], packet[3]
    if length != size - 4:
        raise ProtocolError(f"a packet of {size} bytes whose length field says {4 + length}")
    if _byte_sum(packet) & 0xFF != WHOLE_SUM:
        raise ProtocolError(f"wrong checksum in a packet of servo {servo_id}")
    if servo_id > LARGEST_ID:
        raise ProtocolError(f"not an answer from a servo: id {servo_id}")
    return ServoAnswer(servo_id, packet[4], packet[5:-1])


class FeetechStatusReader(PacketStream[ServoAnswer]):
    """Finds status packets in a stream; see `PacketStream`.

    Args:
        echo: An instruction that may come back on the one wire, and is not an answer.
        largest: Size of the largest expected packet [bytes].
    """

    header = HEADER
    head = AROUND

    def __init__(self, echo: bytes = b"", largest: int = _LARGEST_LENGTH) -> None:
        super().__init__(largest)
        self._echo = echo

    def _size(self, buffer: bytes, start: int) -> int:
        return 4 + buffer[start + 3]

    def _decode(self, packet: bytes) -> ServoAnswer | None:
        status = decode_status(packet)
        if packet != self._echo:
            return status
        self._echo = b""  # comes once, before any answer
        return None

    def _is_suspect(self, packet: bytes) -> bool:
        return packet[2:3] != bytes((BROADCAST_ID,))  # an echo of what all were sent


class FeetechProtocol(ServoProtocol):
    """See `ServoProtocol`."""

    word = 1

    def _packet(self, servo_id: int, instruction: int, parameters: bytes) -> bytes:
        length = len(parameters) + 2
        if length > _LARGEST_LENGTH:
            raise ProtocolError(f"too many parameters, {len(parameters)} of at most {_LARGEST_LENGTH - 2}")
        content = bytes((servo_id, length, instruction)) + parameters
        return HEADER + content + bytes((~sum(content) & 0xFF,))

    def ping(self, servo_id: int) -> bytes:
        """Read a servo's id; after a voltage error the answer to a true ping looks like its echo."""
        return self.read(servo_id, _ID_ADDRESS, ID_SIZE)

    def sync_write_block(self, address: int, size: int, block: bytes) -> bytes:
        head, total = self._sync_write_head(address, size, len(block))
        return head + block + bytes((~_byte_sum(block, total) & 0xFF,))

    @lru_cache  # noqa: B019 -- there is one dialect
    def _sync_write_head(self, address: int, size: int, count: int) -> tuple[bytes, int]:
        """Return the bytes before `count` bytes of a sync write, and their sum for the checksum."""
        packet = self.encode_packet(BROADCAST_ID, SYNC_WRITE, self.words(address, size) + bytes(count))
        head = packet[: -count - 1]
        return head, sum(head[len(HEADER) :])

    def packet_reader(self, request: bytes) -> FeetechStatusReader:
        return FeetechStatusReader(request)


DIALECT: Final = FeetechProtocol()
