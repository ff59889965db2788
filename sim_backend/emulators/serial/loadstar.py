"""A Loadstar DI-1000: answers commands, and streams decimal numbers.

Written from Loadstar's "DI-100U / DI-1000U Command Set" and "DI-1000HS-1K Output Formats".
"""

import math

from sim_backend.emulators.serial.pty_line import SerialSensor
from sim_backend.emulators.serial.timer import StreamTimer

LBF_N = 4.4482216152605


class EmulatedLoadstar(SerialSensor):
    """One interface with its load cell.

    Args:
        capacity_n: capacity [N]; readings go a fifth beyond.
        unit: "lb" or "N", the unit that it is calibrated in.
        rate_hz: readings a second [Hz].
        sign: -1 if the load cell counts tension as positive.
    """

    def __init__(
        self, capacity_n: float, unit: str = "lb", rate_hz: float = 500.0, sign: float = 1.0
    ) -> None:
        self.range_n = 1.2 * capacity_n
        self._unit, self._newtons = unit, {"lb": LBF_N, "N": 1.0}[unit]
        self._capacity_n, self._sign = capacity_n, sign
        self._timer = StreamTimer(rate_hz)
        self._tare_n = self._last_n = 0.0
        self._input = b""
        self._silent_until_s = -math.inf

    def hear(self, data: bytes, now_s: float) -> bytes:
        if now_s < self._silent_until_s:
            return b""
        *commands, self._input = (self._input + data).split(b"\r")
        return b"".join(self._answer(command.strip().upper(), now_s) for command in commands)

    def _answer(self, command: bytes, now_s: float) -> bytes:
        if self._timer.running:
            self._timer.stop()
            return b""
        word = command.decode("ascii", "replace")
        if word == "WC":
            self._timer.start(now_s)
            return b""
        if word in ("CT0", "TARE"):
            self._tare_n = self._last_n
        answers = {
            "": "A",
            "MODEL": "FCM DI-1000",
            "UNITS": self._unit,
            "LC": f"{self._capacity_n / self._newtons:.3f}",
            "CT0": "Tared",
            "TARE": "Tared",
            "W": self.reading(self._last_n).decode().strip(),
        }
        return answers.get(word, "?").encode() + b"\r\n"

    def due(self, now_s: float) -> bool:
        return now_s >= self._silent_until_s and self._timer.due(now_s)

    def reading(self, force_n: float) -> bytes:
        self._last_n = force_n
        return f"{self._sign * (force_n - self._tare_n) / self._newtons:12.4f}\r\n".encode()

    def restart(self, now_s: float, silent_s: float) -> None:
        self._timer.stop()
        self._tare_n, self._input = 0.0, b""
        self._silent_until_s = now_s + silent_s
