"""Finds the packets of servos in a stream of bytes that comes in pieces and may be damaged anywhere."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Generic, TypeVar

from palpate.robot_io.errors import ProtocolError

PacketType = TypeVar("PacketType")


class PacketStream(ABC, Generic[PacketType]):
    """Cuts a stream at headers and lengths; a protocol says where these are.

    Args:
        largest: Size of the largest expected packet [bytes]; a damaged length beyond it is not waited for.

    Attributes:
        rejected: Number of byte sequences that looked like a packet and were none.
    """

    header: ClassVar[bytes]
    head: ClassVar[int]  # bytes after which the length is known

    def __init__(self, largest: int) -> None:
        self._largest = largest
        self._buffer = b""
        self.rejected = 0

    @abstractmethod
    def _size(self, buffer: bytes, start: int) -> int:
        """Size [bytes] of the packet that begins at `start`."""

    @abstractmethod
    def _decode(self, packet: bytes) -> PacketType | None:
        """Decode a packet; None for one that is to be left out. ProtocolError: it is none."""

    def _is_suspect(self, packet: bytes) -> bool:
        """Whether to count a sequence that is no packet as rejected."""
        return True

    def feed(self, data: bytes) -> list[PacketType]:
        """Take more bytes.

        Args:
            data: Bytes in the order of their arrival, cut anywhere.

        Returns:
            The packets that are complete now, oldest first.
        """
        buffer = self._buffer + data
        packets: list[PacketType] = []
        place, available, header, head = 0, len(buffer), self.header, self.head
        while True:
            start = buffer.find(header, place)
            if start < 0:
                place = max(place, available - len(header) + 1)
                break
            place = start
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
                place += 1  # the true header may lie within
                continue
            place = end
            if decoded is not None:
                packets.append(decoded)
        self._buffer = buffer[place:]
        return packets


def equal_parts(data: Mapping[int, bytes]) -> tuple[int, bytes]:
    """Join what a sync write sends to each servo.

    Args:
        data: Bytes by servo id.

    Returns:
        Number of bytes for each servo, and all of them, each after the id of its servo.

    Raises:
        ProtocolError: The bytes are not of equal number.
    """
    sizes = {len(value) for value in data.values()}
    if len(sizes) != 1:
        raise ProtocolError(f"a sync write needs equally many bytes for each servo, not {sorted(sizes)}")
    return sizes.pop(), b"".join(bytes((servo_id,)) + value for servo_id, value in data.items())


def bit_names(value: int, names: Mapping[int, str]) -> str:
    """Name the bits that are set, or say "none".

    Args:
        value: Bits of a device's status.
        names: What each bit means, by its value.
    """
    known = [name for bit, name in names.items() if value & bit]
    unknown = value & ~sum(names)
    return ", ".join([*known, *([f"unknown bits {unknown:#04x}"] if unknown else [])]) or "none"
