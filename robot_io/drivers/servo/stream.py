"""Finds the packets of servos in a stream of bytes that comes in pieces and may be damaged anywhere."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Generic, TypeVar

from robot_io.errors import ProtocolError

PacketType = TypeVar("PacketType")


class PacketStream(ABC, Generic[PacketType]):
    """Cuts a stream at headers and lengths; a protocol says where these are.

    Args:
        largest: no expected packet has more bytes; a damaged length is not waited for.

    Attributes:
        rejected: how many things looked like a packet and were none.
    """

    header: ClassVar[bytes]
    head: ClassVar[int]  # bytes after which the length is known

    def __init__(self, largest: int) -> None:
        self._largest = largest
        self._buffer = b""
        self.rejected = 0

    @abstractmethod
    def _size(self, head: bytes) -> int:
        """Bytes of the packet that begins so."""

    @abstractmethod
    def _decode(self, packet: bytes) -> PacketType | None:
        """What a packet is, None for one that is to be left out. ProtocolError: it is none."""

    def _is_suspect(self, packet: bytes) -> bool:
        """Whether what is no packet is worth being counted."""
        return True

    def feed(self, data: bytes) -> list[PacketType]:
        """Take more bytes; return the packets that are complete now."""
        buffer = self._buffer + data
        found: list[PacketType] = []
        while True:
            start = buffer.find(self.header)
            if start < 0:
                self._buffer = buffer[max(0, len(buffer) - len(self.header) + 1) :]
                return found
            buffer = buffer[start:]
            if len(buffer) < self.head:
                break
            size = self._size(buffer[: self.head])
            if len(buffer) < size <= self._largest:
                break
            buffer = self._take(buffer, size, found)
        self._buffer = buffer
        return found

    def _take(self, buffer: bytes, size: int, found: list[PacketType]) -> bytes:
        packet = buffer[:size]
        try:
            decoded = self._decode(packet)
        except ProtocolError:
            self.rejected += self._is_suspect(packet)
            return buffer[1:]  # the true header may lie within
        if decoded is not None:
            found.append(decoded)
        return buffer[size:]


def equal_parts(data: Mapping[int, bytes]) -> tuple[int, bytes]:
    """How many bytes each servo gets in a sync write, and all of them, each with its id before.

    ProtocolError: the bytes are not of equal number.
    """
    sizes = {len(value) for value in data.values()}
    if len(sizes) != 1:
        raise ProtocolError(f"a sync write needs equally many bytes for each servo, not {sorted(sizes)}")
    return sizes.pop(), b"".join(bytes((servo_id,)) + value for servo_id, value in data.items())


def bit_names(value: int, names: Mapping[int, str]) -> str:
    """The names of the bits that are set, or "none"."""
    found = [name for bit, name in names.items() if value & bit]
    unknown = value & ~sum(names)
    return ", ".join([*found, *([f"unknown bits {unknown:#04x}"] if unknown else [])]) or "none"
