"""Fuzzers of the Dynamixel codec: one packet, a stream of them, and the fast sync read's common answer."""

import numpy as np

from robot_io.drivers.dynamixel.protocol import FastReply, StatusReader, decode_status
from sim_backend.emulators.dynamixel import wire

from ..fuzzer import Fuzzer
from ..status_packets import StatusFuzzer, StatusStreamFuzzer

_IDS, _SIZE = (1, 2, 3), 13
_TRICKY = np.array([0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55, 0xFE, 0x01], dtype=np.uint8)
_INSTRUCTION = 7  # its place in a packet


def _data(rng: np.random.Generator, size: int) -> bytes:
    """Bytes rich in what looks like headers and stuffing."""
    plain = rng.integers(256, size=size, dtype=np.uint8)
    return np.where(rng.random(size) < 0.5, rng.choice(_TRICKY, size), plain).tobytes()


def _status(rng: np.random.Generator) -> bytes:
    """A status packet, or now and then one that is an instruction, such as the echo of what was sent."""
    packet = wire.status(int(rng.integers(253)), int(rng.integers(256)), _data(rng, int(rng.integers(17))))
    if rng.random() < 0.9:
        return packet
    body = packet[:_INSTRUCTION] + bytes((int(rng.integers(0x10)),)) + packet[_INSTRUCTION + 1 : -2]
    return body + wire.checksum(body).to_bytes(2, "little")


class _Wire:
    """The emulator's packets."""

    frame = staticmethod(_status)
    again = staticmethod(wire.status)


class DynamixelPacketFuzzer(_Wire, StatusFuzzer):
    """`decode_status`, which takes exactly one packet."""

    name = "dynamixel_packet"

    def decode(self, data: bytes) -> list[object]:
        return [decode_status(data)]


class DynamixelStreamFuzzer(_Wire, StatusStreamFuzzer):
    """`StatusReader`."""

    name = "dynamixel_stream"

    def __init__(self) -> None:
        super().__init__(StatusReader(128))


class DynamixelFastReplyFuzzer(Fuzzer):
    """`FastReply.decode`, for three servos; its parts are one value, as they are one packet."""

    name = "dynamixel_fast_reply"

    def __init__(self) -> None:
        self._reply = FastReply(_IDS, _SIZE)

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`; now and then servos answer in another order."""
        ids = rng.permutation(_IDS).tolist() if rng.random() < 0.1 else _IDS
        return wire.fast_status([(i, int(rng.integers(256)), _data(rng, _SIZE)) for i in ids], len(ids))

    def decode(self, data: bytes) -> list[object]:
        return [self._reply.decode(data)]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        parts = [(part.servo_id, part.error, part.data) for part in accepted]  # type: ignore[attr-defined]
        return [servo_id for servo_id, _, _ in parts] != list(_IDS) or wire.fast_status(parts, 3) != data
