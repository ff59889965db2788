"""A Bota Systems serial sensor, as the maker's examples meet it; written without its driver."""

import math
import struct

from sim_backend.emulators.serial.pty_line import SerialSensor, StreamTimer

SKIPPED, OVERRANGE, INVALID, RAW = 1, 2, 4, 8  # status bits
_STEP_US = 19.53125  # of one conversion


def crc(data: bytes) -> int:
    """CRC-16 of X.25: reflected, x^16 + x^12 + x^5 + 1, FFFF at the start, inverted at the end."""
    remainder = 0xFFFF
    for byte in data:
        for place in range(8):
            low = (remainder ^ byte >> place) & 1
            remainder = remainder >> 1 ^ (0x8408 if low else 0)
    return ~remainder & 0xFFFF


def frame(status: int, values: list[float], time_us: int, temperature_c: float = 31.5) -> bytes:
    """One frame: three forces, three torques."""
    data = struct.pack("<H", status) + b"".join(struct.pack("<f", value) for value in values)
    data += struct.pack("<If", time_us % 2**32, temperature_c)
    return b"\xaa" + data + struct.pack("<H", crc(data))


class EmulatedBota(SerialSensor):
    """One sensor, of whose axes one is pressed, from 0, up to a capacity [N].

    The length of its filter, which makes its rate, is as it was saved in it.

    Attributes:
        status: status bits beside those of its reading.
        refused: letters of commands that it does not do.
        starts_until_s: when it has started and begins to hear [s].
    """

    def __init__(self, axis: int, capacity_n: float, length: int = 512) -> None:
        self.range_n, self._axis, self.status, self.refused = capacity_n, axis, 0, ""
        self._saved = self._length = length
        self._configures = False
        self.starts_until_s = 0.0
        self._time_us = 0.0
        self._run(0.0)

    def _run(self, now_s: float) -> None:
        self._configures = False
        self._timer = StreamTimer(1e6 / (_STEP_US * self._length))
        self._timer.start(now_s)

    def hear(self, data: bytes, now_s: float) -> bytes:
        word = data.decode("ascii", "replace")
        if now_s < max(self._silent_until_s, self.starts_until_s) or not (self._configures or word == "C"):
            return b""
        if word[:1] in self.refused:
            return f"r,0,{word[:1]},1".encode()
        letter, *values = word.split(",")
        if letter == "C":
            self._configures = True
            self._timer.stop()
        elif letter == "f" and len(values) == 4 and int(values[0]) in (51, 64, 128, 205, 256, 512):
            self._length = int(values[0])
        elif letter == "c" and len(values) == 4:
            self.status = self.status & ~RAW | (0 if values[1] == "1" else RAW)
        elif letter == "R":
            self._run(now_s)
        else:
            return b""
        return f"r,0,{letter},0".encode()

    def reading(self, force_n: float) -> bytes:
        """See `SerialSensor.reading`; without a value it is invalid."""
        self._time_us += self._timer.passed * _STEP_US * self._length
        status, values = self.status, [1.5, -2.5, 3.5, 0.25, -0.5, 0.75]
        if math.isnan(force_n):
            status, force_n = status | INVALID, 0.0
        status |= OVERRANGE if abs(force_n) >= self.range_n else 0
        values[self._axis] = force_n
        return frame(status, values, round(self._time_us))

    def restart(self, now_s: float, silent_s: float) -> None:
        """See `SerialSensor.restart`; it runs by itself again, as it was saved."""
        super().restart(now_s, silent_s)
        self._length, self._time_us = self._saved, 0.0
        self._run(now_s)
