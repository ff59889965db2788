"""Lorenz telegrams, with two checksums, and the stream, with a counter.

Telegrams are made and judged by the emulator, which shares no code with the codec.
"""

import numpy as np

from robot_io.drivers.serial_force.lorenz_protocol import LorenzStream, Telegram, TelegramReader
from sim_backend.emulators.serial.sensors import telegram

from ..fuzzer import Fuzzer, StreamFuzzer


class LorenzTelegramFuzzer(Fuzzer):
    """Telegrams to a fresh reader."""

    name = "lorenz_telegram"

    def frame(self, rng: np.random.Generator) -> bytes:
        parameters = rng.choice(np.array([0, 1, 2, 3, 255], np.uint8), int(rng.integers(12))).tobytes()
        return telegram(int(rng.integers(256)), 255, parameters)

    def decode(self, data: bytes) -> list[object]:
        return list(TelegramReader().feed(data))

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`: made again, it must be there as it came."""
        if not isinstance(accepted, Telegram):
            return True
        again = telegram(accepted.command, accepted.receiver, accepted.parameters, accepted.sender)
        return again not in data


class LorenzStreamFuzzer(StreamFuzzer):
    """One endless stream: a value must stand between two counters that go on by one."""

    name = "lorenz_stream"
    memory = 100

    def __init__(self) -> None:
        super().__init__(LorenzStream(0.5))
        self._counter = 0

    def frame(self, rng: np.random.Generator) -> bytes:
        samples = b""
        for _ in range(6):
            samples += bytes((self._counter,)) + rng.bytes(2)
            self._counter = (self._counter + 1) % 256
        return samples

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        recent = self.seen
        counts = int(2.0 * accepted)  # type: ignore[operator]
        value = bytes((counts // 256 % 256, counts % 256))
        return not any(
            (recent[place + 3] - recent[place]) % 256 == 1 and recent[place + 1 : place + 3] == value
            for place in range(len(recent) - 3)
        )
