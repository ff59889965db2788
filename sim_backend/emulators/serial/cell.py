"""A load cell on a microcontroller, as the firmware in docs/firmware behaves; written without its driver."""

import math

from sim_backend.emulators.serial.pty_line import SerialSensor, StreamTimer

_RAIL = 0x7FFFFF  # of a 24 bit converter


def crc(data: bytes) -> int:
    """CRC-16 with x^16 + x^12 + x^5 + 1, most significant bit first, FFFF at the start."""
    remainder = 0xFFFF
    for byte in data:
        for place in range(7, -1, -1):
            top = remainder >> 15 ^ byte >> place & 1
            remainder = (remainder << 1 & 0xFFFF) ^ (0x1021 if top else 0)
    return remainder


def line(text: str) -> bytes:
    """A line of the firmware."""
    return text.encode() + f"*{crc(text.encode()):04X}\n".encode()


class EmulatedCell(SerialSensor):
    """One cell, with so many newtons in a count, and so many samples a second [Hz]."""

    def __init__(self, newtons_per_count: float, zero_counts: float = 0.0, rate_hz: int = 320) -> None:
        self.range_n = math.inf
        self._counts_per_n, self._zero = 1.0 / newtons_per_count, zero_counts
        self._rate_hz = rate_hz
        self._counter = 0
        self._timer = StreamTimer(rate_hz)
        self._timer.start(0.0)

    def hear(self, data: bytes, now_s: float) -> bytes:
        if now_s < self._silent_until_s:
            return b""
        return line(f"cell 1 nau7802 {self._rate_hz}") * data.count(b"?")

    def reading(self, force_n: float) -> bytes:
        """See `SerialSensor.reading`; without a value it is a fault, and beyond the range its end."""
        self._counter = (self._counter + 1) % 256
        if math.isnan(force_n):
            return line("fault converter")
        counts = force_n * self._counts_per_n + self._zero if math.isfinite(force_n) else math.inf
        return line(f"{self._counter} {round(min(max(counts, -_RAIL - 1), _RAIL))}")

    def restart(self, now_s: float, silent_s: float) -> None:
        """See `SerialSensor.restart`; it streams again by itself."""
        self._counter = 0
        super().restart(now_s, silent_s)
