"""Lorenz telegrams, with two checksums, and the stream, with a counter."""

from typing import ClassVar

import numpy as np

from robot_io.drivers.serial_force.lorenz_protocol import (
    LorenzStream,
    Telegram,
    TelegramReader,
    encode_telegram,
)

from ..fuzzer import Fuzzer


class LorenzTelegramFuzzer(Fuzzer):
    """Telegrams to a fresh reader."""

    name: ClassVar[str] = "lorenz_telegram"

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`."""
        parameters = rng.choice(np.array([0, 1, 2, 3, 255], np.uint8), int(rng.integers(12))).tobytes()
        return encode_telegram(Telegram(int(rng.integers(256)), 1, 255, parameters))

    def decode(self, data: bytes) -> list[object]:
        """See `Fuzzer.decode`."""
        return list(TelegramReader().feed(data))

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """Its bytes with right checksums, summed here, must be there as they are."""
        if not isinstance(accepted, Telegram):
            return True
        head = (accepted.command, accepted.receiver, accepted.sender, len(accepted.parameters))
        content = bytes(head) + accepted.parameters
        running = np.cumsum(np.frombuffer(content, np.uint8).astype(int)) % 256
        weighted = 0
        for value in running.tolist():
            weighted += value
            weighted -= 255 if weighted > 255 else 0
        whole = content + bytes((int(running[-1]), weighted))
        return b"\x02" + whole.replace(b"\x02", b"\x02\x02") not in data


class LorenzStreamFuzzer(Fuzzer):
    """One endless stream: whatever comes, its memory stays short and its values within 16 bits."""

    name: ClassVar[str] = "lorenz_stream"

    def __init__(self) -> None:
        self._stream = LorenzStream(1.0)
        self._counter = 0

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`."""
        samples = b""
        for _ in range(6):
            samples += bytes((self._counter,)) + rng.bytes(2)
            self._counter = (self._counter + 1) % 256
        return samples

    def decode(self, data: bytes) -> list[object]:
        """See `Fuzzer.decode`."""
        return list(self._stream.feed(data))

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`."""
        return not (isinstance(accepted, float) and -32768 <= accepted <= 32767)
