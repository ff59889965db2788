"""Fuzzers of the Dynamixel codec: one packet, a stream of them, and the fast sync read's common answer.

What is accepted is encoded again by the emulator, which shares no code with the codec: these bytes, stuffed,
with length and checksum, must be those that came.
"""

import numpy as np

from robot_io.drivers.dynamixel.protocol import FastReply, StatusPacket, StatusReader, decode_status
from sim_backend.emulators.dynamixel import wire

from ..fuzzer import Fuzzer

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


def _again(accepted: object) -> bytes:
    """The packet that an accepted one must have been; nothing starts with what is no packet."""
    if not isinstance(accepted, StatusPacket) or not 0 <= accepted.servo_id < 253:
        return b"no packet"
    return wire.status(accepted.servo_id, accepted.error, accepted.data)


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
        return _again(accepted) != data


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
        """Whether its bytes are not in the stream."""
        return _again(accepted) not in self._recent


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
        """See `Fuzzer.decode`."""
        return [self._reply.decode(data)]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`."""
        parts = [(part.servo_id, part.error, part.data) for part in accepted]  # type: ignore[attr-defined]
        return [servo_id for servo_id, _, _ in parts] != list(_IDS) or wire.fast_status(parts, 3) != data
