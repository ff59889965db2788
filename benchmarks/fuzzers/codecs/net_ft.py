"""ATI Net F/T: a force must be that of a whole datagram whose status is good, as its emulator writes it."""

import numpy as np

from robot_io.drivers.net_ft.protocol import NetFtStream
from sim_backend.emulators.net_ft.box import record

from ..fuzzer import Fuzzer


class NetFtFuzzer(Fuzzer):
    """A datagram to a fresh stream; what counters do to others is for the tests."""

    name = "net_ft"

    def __init__(self) -> None:
        self._sequence = 0

    def frame(self, rng: np.random.Generator) -> bytes:
        self._sequence += 1
        counts = [int(one) for one in rng.integers(-(2**31), 2**31, 6)]
        status = 0 if rng.random() < 0.9 else 1 << int(rng.integers(32))
        return record(self._sequence, 7 * self._sequence, status, counts)

    def decode(self, data: bytes) -> list[object]:
        return list(NetFtStream(1.0, "y", 1000).feed(data))

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`: 36 bytes, no error, and counts at the place of the axis."""
        counts = int.from_bytes(data[16:20], "big", signed=True)
        status = int.from_bytes(data[8:12], "big")
        is_bad = len(data) != 36 or bool(status & 0x7FFEFFFF) or abs(counts) >= 2**31 - 1
        return is_bad or accepted != float(counts)
