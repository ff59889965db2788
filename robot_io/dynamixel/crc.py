"""The checksum of Dynamixel Protocol 2.0.

CRC-16 with the polynomial x^16 + x^15 + x^2 + 1 (0x8005), start value 0, most significant bit first, over the
whole packet from its header on. Source: ROBOTIS e-manual, "CRC Calculation".
"""

_POLYNOMIAL = 0x8005


def _table_entry(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = (value << 1) ^ (_POLYNOMIAL if value & 0x8000 else 0)
    return value & 0xFFFF


_TABLE = tuple(_table_entry(byte) for byte in range(256))


def crc16(data: bytes, start: int = 0) -> int:
    """The checksum of `data`; `start` is the checksum of what came before it."""
    crc, table = start, _TABLE
    for byte in data:
        crc = ((crc << 8) & 0xFF00) ^ table[(crc >> 8) ^ byte]
    return crc
