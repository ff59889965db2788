"""Fuzzers of the Dynamixel codec: one packet, a stream of them, and the fast sync read's common answer.

What is accepted must carry a right checksum by the emulator's arithmetic, which shares no code with the
codec.
"""

import numpy as np

from robot_io.drivers.dynamixel.protocol import FastReply, StatusPacket, StatusReader, decode_status
from sim_backend.emulators.dynamixel import wire

from ..fuzzer import Fuzzer

_IDS, _SIZE = (1, 2, 3), 13
_TRICKY = np.array([0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55, 0xFE, 0x01], dtype=np.uint8)


def _data(rng: np.random.Generator, size: int) -> bytes:
    """Bytes rich in what looks like headers and stuffing."""
    plain = rng.integers(256, size=size, dtype=np.uint8)
    return np.where(rng.random(size) < 0.5, rng.choice(_TRICKY, size), plain).tobytes()


def _status(rng: np.random.Generator) -> bytes:
    return wire.status(int(rng.integers(253)), int(rng.integers(256)), _data(rng, int(rng.integers(17))))


def _checksum_is_wrong(packet: bytes) -> bool:
    return wire.checksum(packet[:-2]) != packet[-2] + 256 * packet[-1]


class DynamixelPacketFuzzer(Fuzzer):
    """`decode_status`, which takes exactly one packet."""

    name = "dynamixel_packet"

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`."""
        return _status(rng)

    def decode(self, data: bytes) -> list[object]:
        """See `Fuzzer.decode`."""
        return [decode_status(data)]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`."""
        return _checksum_is_wrong(data)


class DynamixelStreamFuzzer(Fuzzer):
    """`StatusReader`, which finds packets in a stream; each input continues the stream."""

    name = "dynamixel_stream"

    def __init__(self) -> None:
        self._reader = StatusReader(128)
        self._recent = b""

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`."""
        return _status(rng)

    def decode(self, data: bytes) -> list[object]:
        """See `Fuzzer.decode`."""
        self._recent = (self._recent + data)[-2048:]
        return list(self._reader.feed(data))

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """Whether no packet of that servo with a right checksum is in the stream."""
        stream = self._recent
        start = stream.find(b"\xff\xff\xfd\x00")
        while start >= 0:
            head = stream[start : start + 7]
            end = start + 7 + head[5] + 256 * head[6] if len(head) == 7 else 0
            packet = stream[start:end]
            mine = isinstance(accepted, StatusPacket) and len(packet) > 10 and packet[4] == accepted.servo_id
            if mine and end <= len(stream) and not _checksum_is_wrong(packet):
                return False
            start = stream.find(b"\xff\xff\xfd\x00", start + 1)
        return True


class DynamixelFastReplyFuzzer(Fuzzer):
    """`FastReply.decode`, for three servos."""

    name = "dynamixel_fast_reply"

    def __init__(self) -> None:
        self._reply = FastReply(_IDS, _SIZE)

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`."""
        return wire.fast_status([(i, int(rng.integers(256)), _data(rng, _SIZE)) for i in _IDS], len(_IDS))

    def decode(self, data: bytes) -> list[object]:
        """See `Fuzzer.decode`."""
        return list(self._reply.decode(data))

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`."""
        return _checksum_is_wrong(data) or not isinstance(accepted, StatusPacket)
