"""Packets of servos: instructions, and answers in a stream that comes in pieces and may be damaged."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Final, Generic, NamedTuple, TypeVar

from palpate.robot_io.errors import ProtocolError

PacketType = TypeVar("PacketType")


class ServoAnswer(NamedTuple):
    """Answer of a servo; one that reports no refusals, unless a protocol says otherwise."""

    servo_id: int  # id of the answering servo
    error: int  # error byte
    data: bytes  # parameters

    @property
    def alert(self) -> bool:
        """Whether the servo reports an error."""
        return self.error != 0

    @property
    def refusal(self) -> str | None:
        """Reason why the instruction was refused; None if it was not."""
        return None


class PacketStream(ABC, Generic[PacketType]):
    """Splits a stream at headers and lengths, which each protocol defines.

    Args:
        largest: Size of the largest expected packet [bytes]; a larger length is treated as damaged.

    Attributes:
        pending: Received bytes that may begin a packet.
        rejected: Number of byte sequences that began like a packet but were invalid.
    """

    header: ClassVar[bytes]
    head: ClassVar[int]  # bytes after which the length is known

    def __init__(self, largest: int) -> None:
        self._largest = largest
        self.pending = b""
        self.rejected = 0

    @abstractmethod
    def _size(self, buffer: bytes, start: int) -> int:
        """Return the size of the packet that begins at `start` [bytes]."""

    @abstractmethod
    def _decode(self, packet: bytes) -> PacketType | None:
        """Decode a packet; None if it is to be ignored; raise `ProtocolError` if it is invalid."""

    def _is_suspect(self, packet: bytes) -> bool:
        """Return whether to count a sequence that is not a packet as rejected."""
        return True

    def feed(self, data: bytes) -> list[PacketType]:
        """Process received bytes; return the packets that are complete now, oldest first.

        Args:
            data: Bytes in the order of their arrival, cut anywhere.
        """
        buffer = self.pending + data
        packets: list[PacketType] = []
        index, available, header, head = 0, len(buffer), self.header, self.head
        while True:
            start = buffer.find(header, index)
            if start < 0:
                index = max(index, available - len(header) + 1)
                break
            index = start
            if available < start + head:
                break
            end = start + self._size(buffer, start)
            if available < end <= start + self._largest:
                break
            packet = buffer[start:end]
            try:
                decoded = self._decode(packet)
            except ProtocolError:
                self.rejected += self._is_suspect(packet)
                index += 1  # the true header may lie within
                continue
            index = end
            if decoded is not None:
                packets.append(decoded)
        self.pending = buffer[index:]
        return packets


LARGEST_ID: Final = 0xFC
BROADCAST_ID: Final = 0xFE
_PING, _READ, _WRITE, _SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x82, 0x83


class ServoProtocol(ABC):
    """Encoder of instructions, and factory of readers of their answers."""

    word: ClassVar[int]  # bytes of an address or a size

    @abstractmethod
    def _packet(self, servo_id: int, instruction: int, parameters: bytes) -> bytes:
        """Make an instruction packet; raise `ProtocolError` if it would be too long."""

    @abstractmethod
    def sync_write_block(self, address: int, size: int, block: bytes) -> bytes:
        """Write at the same address of several servos, without answers.

        Args:
            address: address of the first byte.
            size: Number of bytes for each servo.
            block: For each servo its id and its bytes.
        """

    @abstractmethod
    def packet_reader(self, request: bytes) -> PacketStream[Any]:
        """Make the reader that finds the answers to a request, but not its echo.

        Args:
            request: packet that the servos were sent.
        """

    def encode_packet(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Encode an instruction packet; raise `ProtocolError` for an impossible id or too many bytes.

        Args:
            servo_id: Servo that is addressed, or `BROADCAST_ID` for all.
            instruction: Code of the instruction.
            parameters: Its parameters, not stuffed.
        """
        if not (0 <= servo_id <= LARGEST_ID or servo_id == BROADCAST_ID):
            raise ProtocolError(f"{servo_id} is not a servo id: 0 to {LARGEST_ID}, or {BROADCAST_ID} for all")
        return self._packet(servo_id, instruction, parameters)

    def words(self, *values: int) -> bytes:
        """Encode addresses and sizes.

        Args:
            values: numbers, each of `word` bytes.
        """
        return b"".join(value.to_bytes(self.word, "little") for value in values)

    def ping(self, servo_id: int) -> bytes:
        """Encode an instruction to ping one servo.

        Args:
            servo_id: id of the servo, from 0 to `LARGEST_ID`.
        """
        return self.encode_packet(servo_id, _PING)

    def ping_all(self) -> bytes:
        """Ping all servos; each answers after those with smaller ids."""
        return self.encode_packet(BROADCAST_ID, _PING)

    def read(self, servo_id: int, address: int, size: int) -> bytes:
        """Encode an instruction to read bytes of one servo.

        Args:
            servo_id: id of the servo.
            address: address of the first byte.
            size: number of bytes.
        """
        return self.encode_packet(servo_id, _READ, self.words(address, size))

    def write(self, servo_id: int, address: int, data: bytes) -> bytes:
        """Encode an instruction to write bytes of one servo, which acknowledges with an empty answer.

        Args:
            servo_id: id of the servo.
            address: address of the first byte.
            data: the bytes, as the registers store them.
        """
        return self.encode_packet(servo_id, _WRITE, self.words(address) + data)

    def sync_read(self, address: int, size: int, servo_ids: Sequence[int]) -> bytes:
        """Encode an instruction to read the same bytes of several servos.

        Args:
            address: address of the first byte.
            size: number of bytes of each servo.
            servo_ids: ids of the servos; each answers with its own packet, in this order.
        """
        return self.encode_packet(BROADCAST_ID, _SYNC_READ, self.words(address, size) + bytes(servo_ids))

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> bytes:
        """Write at one address of several servos, without answers; raise `ProtocolError` for unequal sizes.

        Args:
            address: address of the first byte.
            data: Bytes by servo id.
        """
        sizes = {len(value) for value in data.values()}
        if len(sizes) != 1:
            raise ProtocolError(
                f"a sync write needs equal numbers of bytes for all servos, not {sorted(sizes)}"
            )
        block = b"".join(bytes((servo_id,)) + value for servo_id, value in data.items())
        return self.sync_write_block(address, sizes.pop(), block)


def bit_names(value: int, names: Mapping[int, str]) -> str:
    """Name the bits that are set, or say "none".

    Args:
        value: Bits of a device's status.
        names: Name of each bit, by its value.
    """
    known = [name for bit, name in names.items() if value & bit]
    unknown = value & ~sum(names)
    return ", ".join([*known, *([f"unknown bits {unknown:#04x}"] if unknown else [])]) or "none"
