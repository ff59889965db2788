"""Feetech's serial servo protocol as bytes, which is close to Dynamixel Protocol 1.0; no ports, no clocks.

A packet is FF FF, id, length, instruction, parameters, checksum. The length counts everything after itself,
and the checksum is the inverted sum of everything after the header. A servo answers with an error byte in
place of the instruction, so that the echo of an instruction looks like an answer. STS servos are
little-endian. Source: Feetech, "Magnetic encoder smart servo communication protocol" (SMS/STS series).
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

from palpate.robot_io.drivers.servo.stream import PacketStream, bit_names, equal_parts
from palpate.robot_io.errors import ProtocolError

HEADER: Final = b"\xff\xff"
LARGEST_ID: Final = 0xFC
BROADCAST_ID: Final = 0xFE
AROUND: Final = 6  # bytes of an answer around its data

_PING, _READ, _WRITE, _SYNC_READ, _SYNC_WRITE = 0x01, 0x02, 0x03, 0x82, 0x83
_ID_ADDRESS = 5
_WHOLE_SUM = (sum(HEADER) + 0xFF) & 0xFF  # of a packet with its checksum, which inverts the rest
ID_SIZE: Final = 1  # bytes of the answer to `ping`
_LARGEST_LENGTH = 0xFA

ERROR_NAMES: Final = {
    0x01: "input voltage",
    0x02: "position sensor",
    0x04: "overheating",
    0x08: "over current",
    0x20: "overload",
}


def error_names(value: int) -> str:
    """Name the errors in an error byte.

    Args:
        value: error byte of an answer, one bit an error.
    """
    return bit_names(value, ERROR_NAMES)


def checksum(content: bytes) -> int:
    """Compute the checksum of everything between header and itself.

    Args:
        content: bytes of the packet.
    """
    return ~sum(content) & 0xFF


class FeetechStatus(NamedTuple):
    """What a servo answers."""

    servo_id: int  # who answers
    error: int  # error byte, see `error_names`
    data: bytes  # parameters

    @property
    def alert(self) -> bool:
        """Whether the servo has an error of its own."""
        return self.error != 0

    @property
    def refusal(self) -> str | None:
        """Nothing: these servos do not say that they refuse."""
        return None


def encode_packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Encode an instruction packet.

    Args:
        servo_id: Servo that is addressed, or `BROADCAST_ID` for all.
        instruction: Code of the instruction.
        parameters: Its parameters.

    Raises:
        ProtocolError: No servo can have this id, or the packet would be too long.
    """
    if not (0 <= servo_id <= LARGEST_ID or servo_id == BROADCAST_ID):
        raise ProtocolError(f"{servo_id} is no servo id: 0 to {LARGEST_ID}, or {BROADCAST_ID} for all")
    length = len(parameters) + 2
    if length > _LARGEST_LENGTH:
        raise ProtocolError(f"{len(parameters)} parameters are too many, at most {_LARGEST_LENGTH - 2}")
    content = bytes((servo_id, length, instruction)) + parameters
    return HEADER + content + bytes((checksum(content),))


def decode_status(packet: bytes) -> FeetechStatus:
    """Decode a status packet.

    Args:
        packet: The whole packet and nothing else.

    Raises:
        ProtocolError: It is no status packet, or its checksum is wrong.
    """
    size = len(packet)
    if size < AROUND or not packet.startswith(HEADER):
        raise ProtocolError(f"not a packet: {packet[:16].hex(' ')}")
    servo_id, length = packet[2], packet[3]
    if length != size - 4:
        raise ProtocolError(f"a packet of {size} bytes that says {4 + length}")
    if sum(packet) & 0xFF != _WHOLE_SUM:
        raise ProtocolError(f"wrong checksum in a packet of servo {servo_id}")
    if servo_id > LARGEST_ID:
        raise ProtocolError(f"not an answer of a servo: id {servo_id}")
    return FeetechStatus(servo_id, packet[4], packet[5:-1])


class FeetechStatusReader(PacketStream[FeetechStatus]):
    """Finds status packets in a stream; see `PacketStream`.

    Args:
        echo: An instruction that may come back on the one wire, and is no answer.
        largest: Size of the largest expected packet [bytes].
    """

    header = HEADER
    head = AROUND

    def __init__(self, echo: bytes = b"", largest: int = _LARGEST_LENGTH) -> None:
        super().__init__(largest)
        self._echo = echo

    def _size(self, buffer: bytes, start: int) -> int:
        return 4 + buffer[start + 3]

    def _decode(self, packet: bytes) -> FeetechStatus | None:
        status = decode_status(packet)
        if packet != self._echo:
            return status
        self._echo = b""  # comes once, before any answer
        return None

    def _is_suspect(self, packet: bytes) -> bool:
        return packet[2:3] != bytes((BROADCAST_ID,))  # an echo of what all were sent


def packet_reader(request: bytes) -> FeetechStatusReader:
    """Make what finds the answers to a request, and not its echo.

    Args:
        request: packet that the servos were sent.
    """
    return FeetechStatusReader(request)


def ping(servo_id: int) -> bytes:
    """Ask a servo for its id: with a voltage error the answer to a true ping is like its echo.

    Args:
        servo_id: of the servo.
    """
    return read(servo_id, _ID_ADDRESS, ID_SIZE)


def ping_all() -> bytes:
    """Ask who is on the line; each servo answers with an empty packet, after those with smaller ids."""
    return encode_packet(BROADCAST_ID, _PING)


def read(servo_id: int, address: int, size: int) -> bytes:
    """Read `size` bytes at `address`.

    Args:
        servo_id: of the servo.
        address: of the first byte.
        size: number of bytes.
    """
    return encode_packet(servo_id, _READ, bytes((address, size)))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    """Write `data` at `address`; acknowledged with an empty answer.

    Args:
        servo_id: of the servo.
        address: of the first byte.
        data: the bytes.
    """
    return encode_packet(servo_id, _WRITE, bytes((address,)) + data)


def sync_read(address: int, size: int, servo_ids: Sequence[int]) -> bytes:
    """Read the same bytes of several servos; each answers with a packet of its own, in this order.

    Args:
        address: of the first byte.
        size: number of bytes from each servo.
        servo_ids: in the order of the answers.
    """
    return encode_packet(BROADCAST_ID, _SYNC_READ, bytes((address, size, *servo_ids)))


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
    head, total = _sync_write_head(address, size, len(block))
    return head + block + bytes((~(total + sum(block)) & 0xFF,))


@lru_cache
def _sync_write_head(address: int, size: int, count: int) -> tuple[bytes, int]:
    """What comes before `count` bytes of a sync write, and the sum that its checksum is made of."""
    head = encode_packet(BROADCAST_ID, _SYNC_WRITE, bytes((address, size)) + bytes(count))[: -count - 1]
    return head, sum(head[len(HEADER) :])
