"""What can be asked of servos, as bytes.

Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0", Instruction Details.
"""

from collections.abc import Mapping, Sequence

from robot_io.dynamixel.packet import BROADCAST_ID, encode_packet
from robot_io.errors import ProtocolError

_PING, _READ, _WRITE, _REBOOT = 0x01, 0x02, 0x03, 0x08
_SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x82, 0x83, 0x8A


def ping(servo_id: int) -> bytes:
    """Who are you? The answer is model number (2 bytes) and firmware version (1 byte)."""
    return encode_packet(servo_id, _PING)


def reboot(servo_id: int) -> bytes:
    """Restart; the only way out of a hardware error."""
    return encode_packet(servo_id, _REBOOT)


def read(servo_id: int, address: int, size: int) -> bytes:
    """Read `size` bytes at `address`."""
    return encode_packet(servo_id, _READ, _word(address) + _word(size))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    """Write `data` at `address`; acknowledged with an empty answer."""
    return encode_packet(servo_id, _WRITE, _word(address) + data)


def sync_read(address: int, size: int, servo_ids: Sequence[int]) -> bytes:
    """Read the same bytes of several servos; each answers with a packet of its own, in this order."""
    return encode_packet(BROADCAST_ID, _SYNC_READ, _word(address) + _word(size) + bytes(servo_ids))


def fast_sync_read(address: int, size: int, servo_ids: Sequence[int]) -> bytes:
    """Read the same bytes of several servos, which make one packet together; see `fast_reply`."""
    return encode_packet(BROADCAST_ID, _FAST_SYNC_READ, _word(address) + _word(size) + bytes(servo_ids))


def sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Write at the same address of several servos, each its own bytes; nobody answers.

    Raises:
        ProtocolError: the bytes are not of equal number.
    """
    sizes = {len(value) for value in data.values()}
    if len(sizes) != 1:
        raise ProtocolError(f"a sync write needs equally many bytes for each servo, not {sorted(sizes)}")
    parts = b"".join(bytes((servo_id,)) + value for servo_id, value in data.items())
    return encode_packet(BROADCAST_ID, _SYNC_WRITE, _word(address) + _word(sizes.pop()) + parts)


def _word(value: int) -> bytes:
    return value.to_bytes(2, "little")
