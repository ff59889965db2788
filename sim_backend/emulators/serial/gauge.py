"""A force gauge that writes one line a sample, unasked, as a Mark-10 in continuous output does."""

import math

from sim_backend.emulators.serial.pty_line import SerialSensor
from sim_backend.emulators.serial.timer import StreamTimer


class EmulatedGauge(SerialSensor):
    """One gauge; it writes "-12.34 N".

    Args:
        capacity_n: end of its range [N].
        rate_hz: lines a second [Hz].
        sign: -1 if it counts tension as positive.
    """

    def __init__(self, capacity_n: float, rate_hz: float = 500.0, sign: float = 1.0) -> None:
        self.range_n = capacity_n
        self._sign = sign
        self._timer = StreamTimer(rate_hz)
        self._timer.start(0.0)
        self._silent_until_s = -math.inf

    def hear(self, data: bytes, now_s: float) -> bytes:
        """See `SerialSensor.hear`: it does not listen."""
        return b""

    def due(self, now_s: float) -> bool:
        return now_s >= self._silent_until_s and self._timer.due(now_s)

    def reading(self, force_n: float) -> bytes:
        return f"{self._sign * force_n:.3f} N\r\n".encode()

    def restart(self, now_s: float, silent_s: float) -> None:
        self._silent_until_s = now_s + silent_s
