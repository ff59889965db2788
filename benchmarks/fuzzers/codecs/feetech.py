"""Fuzzers of the Feetech codec: one packet, and a stream of them.

What is accepted is encoded again by the emulator, which shares no code with the codec: these bytes must be
those that came.
"""

import numpy as np

from robot_io.drivers.feetech.protocol import StatusPacket, StatusReader, decode_status
from sim_backend.emulators.feetech import wire

from ..fuzzer import Fuzzer

_TRICKY = np.array([0xFF, 0xFF, 0xFE, 0x00, 0x02, 0x82], dtype=np.uint8)


def _status(rng: np.random.Generator) -> bytes:
    """An answer rich in what looks like headers, or now and then the echo of a sync read."""
    size = int(rng.integers(40))
    plain = rng.integers(256, size=size, dtype=np.uint8)
    data = np.where(rng.random(size) < 0.3, rng.choice(_TRICKY, size), plain).tobytes()
    servo_id = int(rng.integers(253)) if rng.random() < 0.9 else wire.BROADCAST
    return wire.status(servo_id, int(rng.integers(64)), data)


def _again(accepted: object) -> bytes:
    """The packet that an accepted one must have been; nothing starts with what is no packet."""
    if not isinstance(accepted, StatusPacket) or not 0 <= accepted.servo_id < 253:
        return b"no packet"
    return wire.status(*accepted)


class FeetechPacketFuzzer(Fuzzer):
    """`decode_status`, which takes exactly one packet."""

    name = "feetech_packet"

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`."""
        return _status(rng)

    def decode(self, data: bytes) -> list[object]:
        """See `Fuzzer.decode`."""
        return [decode_status(data)]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`."""
        return _again(accepted) != data


class FeetechStreamFuzzer(Fuzzer):
    """`StatusReader`, which finds packets in a stream; each input continues the stream."""

    name = "feetech_stream"

    def __init__(self) -> None:
        self._reader = StatusReader(largest=64)
        self._recent = b""

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`."""
        return _status(rng)

    def decode(self, data: bytes) -> list[object]:
        """See `Fuzzer.decode`."""
        self._recent = (self._recent + data)[-2048:]
        return list(self._reader.feed(data))

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """Whether its bytes are not in the stream."""
        return _again(accepted) not in self._recent
