"""Bota sensors: a force must be that of a frame whose CRC its emulator would have made."""

import numpy as np

from robot_io.drivers.bota.protocol import FRAME_SIZE, BotaStream
from sim_backend.emulators.serial.bota import crc, frame

from ..fuzzer import StreamFuzzer


class BotaFuzzer(StreamFuzzer):
    """One endless stream."""

    name = "bota"
    memory = 100

    def __init__(self) -> None:
        super().__init__(BotaStream("z", 100.0))
        self._time_us = 0

    def frame(self, rng: np.random.Generator) -> bytes:
        self._time_us += 1250
        status = 0 if rng.random() < 0.9 else 1 << int(rng.integers(16))
        return frame(status, rng.normal(scale=30.0, size=6).tolist(), self._time_us)

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        starts = (k for k in range(len(self.seen) - FRAME_SIZE + 1) if self.seen[k] == 0xAA)
        return not any(_says(self.seen[k + 1 : k + FRAME_SIZE], accepted) for k in starts)


def _says(body: bytes, force_n: object) -> bool:
    data, status = body[:-2], body[0] + 256 * body[1]
    if crc(data) != body[-2] + 256 * body[-1] or status & ~2:
        return False
    found = float(np.frombuffer(data[10:14], "<f4")[0])
    return force_n in ((found,) if status == 0 else (found, 100.0, -100.0))
