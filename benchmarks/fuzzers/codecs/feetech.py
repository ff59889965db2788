"""Fuzzers of the Feetech codec: one packet, and a stream of them."""

import numpy as np

from robot_io.drivers.feetech.protocol import StatusReader, decode_status
from sim_backend.emulators.feetech import wire

from ..status_packets import StatusFuzzer, StatusStreamFuzzer

_TRICKY = np.array([0xFF, 0xFF, 0xFE, 0x00, 0x02, 0x82], dtype=np.uint8)


def _status(rng: np.random.Generator) -> bytes:
    """An answer rich in what looks like headers, or now and then the echo of a sync read."""
    size = int(rng.integers(40))
    plain = rng.integers(256, size=size, dtype=np.uint8)
    data = np.where(rng.random(size) < 0.3, rng.choice(_TRICKY, size), plain).tobytes()
    servo_id = int(rng.integers(253)) if rng.random() < 0.9 else wire.BROADCAST
    return wire.status(servo_id, int(rng.integers(64)), data)


class _Wire:
    """The emulator's packets."""

    frame = staticmethod(_status)
    again = staticmethod(wire.status)


class FeetechPacketFuzzer(_Wire, StatusFuzzer):
    """`decode_status`, which takes exactly one packet."""

    name = "feetech_packet"

    def decode(self, data: bytes) -> list[object]:
        return [decode_status(data)]


class FeetechStreamFuzzer(_Wire, StatusStreamFuzzer):
    """`StatusReader`."""

    name = "feetech_stream"

    def __init__(self) -> None:
        super().__init__(StatusReader(largest=64))
