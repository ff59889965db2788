"""The one packet that several servos make together when they answer a fast sync read.

Each servo in turn adds an error byte, its id, its data and a checksum; the first one puts a status packet's
head before its part, with the broadcast id and the length of the whole. A checksum is over everything before
it, earlier checksums included. No bytes are stuffed.
Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0", Fast Sync Read (0x8A).
"""

from collections.abc import Sequence

from robot_io.dynamixel.crc import crc16
from robot_io.dynamixel.packet import BROADCAST_ID, HEADER, StatusPacket
from robot_io.errors import ProtocolError

_HEAD = 8  # bytes before the first servo's part
_AROUND_DATA = 4  # error, id and checksum of a part
_STATUS = 0x55


class FastReply:
    """How the answer to one fast sync read must look.

    Args:
        servo_ids: the servos in the order in which they were asked.
        data_size: bytes asked of each.

    Attributes:
        size: bytes of the whole answer.
    """

    def __init__(self, servo_ids: Sequence[int], data_size: int) -> None:
        self._ids = tuple(servo_ids)
        self._part = data_size + _AROUND_DATA
        self.size = _HEAD + len(self._ids) * self._part
        self._head = HEADER + bytes((BROADCAST_ID,)) + (self.size - 7).to_bytes(2, "little")
        self._head += bytes((_STATUS,))

    def start_in(self, data: bytes) -> int:
        """Where in `data` this answer starts, or -1."""
        return data.find(self._head)

    def answered(self, data: bytes) -> int:
        """How many servos have added their part to an answer that is not complete."""
        return max(0, (len(data) - _HEAD) // self._part)

    def decode(self, packet: bytes) -> list[StatusPacket]:
        """Each servo's part of a whole answer.

        Raises:
            ProtocolError: it is not such an answer, a checksum is wrong, or a part is another servo's.
        """
        if len(packet) != self.size or not packet.startswith(self._head):
            raise ProtocolError(f"not the answer to a fast sync read: {packet[:16].hex(' ')}")
        if crc16(packet[:-2]) != packet[-2] | packet[-1] << 8:
            raise ProtocolError(f"wrong checksum in {self._damaged_part(packet)} part of a fast sync read")
        parts = []
        for servo_id, start in zip(self._ids, range(_HEAD, self.size, self._part), strict=True):
            if packet[start + 1] != servo_id:
                raise ProtocolError(f"servo {packet[start + 1]} answered in place of servo {servo_id}")
            parts.append(StatusPacket(servo_id, packet[start], packet[start + 2 : start + self._part - 2]))
        return parts

    def _damaged_part(self, packet: bytes) -> str:
        """Whose part has the first wrong checksum; the last one covers all, and is enough to accept."""
        ends = range(_HEAD + self._part, self.size, self._part)
        for servo_id, end in zip(self._ids, ends, strict=False):
            if crc16(packet[: end - 2]) != packet[end - 2] | packet[end - 1] << 8:
                return f"servo {servo_id}'s"
        return f"servo {self._ids[-1]}'s"
