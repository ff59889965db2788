"""The sensors at the end of the line: a gauge that writes lines, a Loadstar DI-1000, a Lorenz LCV-USB2.

Written from Loadstar's "DI-100U / DI-1000U Command Set" and "DI-1000HS-1K Output Formats", and, for Lorenz,
from the description of the sensor interface protocol that LorenzTelegram follows: STX doubled within a
telegram, sum and weighted sum as checksums, configuration blocks of 32 bytes, stream mode 3.
"""

import math

from sim_backend.emulators.serial.pty_line import SerialSensor, StreamTimer


class EmulatedGauge(SerialSensor):
    """One gauge, up to a capacity [N]; it writes "-12.34 N", so many lines a second [Hz]."""

    def __init__(self, capacity_n: float, rate_hz: float = 500.0) -> None:
        self.range_n = capacity_n
        self._timer = StreamTimer(rate_hz)
        self._timer.start(0.0)

    def hear(self, data: bytes, now_s: float) -> bytes:
        """See `SerialSensor.hear`: it does not listen."""
        return b""

    def reading(self, force_n: float) -> bytes:
        return f"{force_n:.3f} N\r\n".encode()


LBF_N = 4.4482216152605


class EmulatedLoadstar(SerialSensor):
    """One interface with its load cell; readings go a fifth beyond its capacity [N].

    Attributes:
        width: characters of a reading; 0 pads none, as some interfaces do.
    """

    width = 12

    def __init__(self, capacity_n: float, unit: str = "lb", rate_hz: float = 500.0) -> None:
        self.range_n = 1.2 * capacity_n
        self._unit, self._newtons = unit, {"lb": LBF_N, "N": 1.0}[unit]
        self._capacity_n = capacity_n
        self._timer = StreamTimer(rate_hz)
        self._tare_n = self._last_n = 0.0
        self._input = b""

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

    def reading(self, force_n: float) -> bytes:
        self._last_n = force_n
        return f"{(force_n - self._tare_n) / self._newtons:{self.width}.4f}\r\n".encode()

    def restart(self, now_s: float, silent_s: float) -> None:
        self._timer.stop()
        self._tare_n, self._input = 0.0, b""
        super().restart(now_s, silent_s)


ADDRESS = 1
CONFIG_TIME_S = 200e-6  # the rate code counts periods of 200 us


def _sums(content: bytes) -> bytes:
    total, weighted = 0, 0
    for byte in content:
        total = (total + byte) % 256
        weighted += total
        if weighted > 255:
            weighted = (weighted + 1) % 256
    return bytes((total, weighted))


def telegram(command: int, to: int, parameters: bytes = b"", sender: int = ADDRESS) -> bytes:
    """What a sensor sends: STX, and what follows with every 02 doubled."""
    content = bytes((command, to, sender, len(parameters))) + parameters
    stuffed = b"".join(
        bytes((byte, byte)) if byte == 2 else bytes((byte,)) for byte in content + _sums(content)
    )
    return b"\x02" + stuffed


class EmulatedLorenz(SerialSensor):
    """One sensor, with so many counts at its nominal load [N], and the codes of its unit and of that load."""

    def __init__(
        self,
        nominal_n: float,
        counts_at_nominal: float = 25000.0,
        dimension_code: int = 3,
        load_code: int = 100,
    ) -> None:
        self.range_n = nominal_n * 32767 / counts_at_nominal
        self._counts_per_n = counts_at_nominal / nominal_n
        self._dimension_code, self._load_code = dimension_code, load_code
        self._timer = StreamTimer(1000.0)
        self._counter = 0
        self._input = b""
        self._stx_in_a_row = 0

    def hear(self, data: bytes, now_s: float) -> bytes:
        if now_s < self._silent_until_s:
            return b""
        answers = b""
        for byte in data:
            self._stx_in_a_row = self._stx_in_a_row + 1 if byte == 2 else 0
            if self._timer.running:
                if self._stx_in_a_row == 3:
                    self._timer.stop()
                continue
            self._input = (self._input + bytes((byte,)))[-600:]
            answers += self._try(now_s)
        return answers

    def _try(self, now_s: float) -> bytes:
        """Obey the telegram that the input ends with, if it does."""
        for start in (place for place, byte in enumerate(self._input) if byte == 2):
            stuffed = self._input[start + 1 :]
            content = stuffed.replace(b"\x02\x02", b"\x02")
            whole = len(content) >= 6 and len(content) == 6 + content[3]
            whole = whole and content.replace(b"\x02", b"\x02\x02") == stuffed
            if whole and _sums(content[:-2]) == content[-2:] and content[1] in (0, ADDRESS):
                self._input = b""
                return self._obey(content[0], content[2], content[4:-2], now_s)
        return b""

    def _obey(self, command: int, host: int, parameters: bytes, now_s: float) -> bytes:
        if command == 0x40:
            return telegram(0x40, host, b"\x01")
        if command == 0x44 and parameters == b"\x80":
            return telegram(0x44, host, b"\x80" + self._rotor_header())
        if command == 0x5A and len(parameters) == 5 and parameters[0] == 3 and parameters[1] > 0:
            self._timer = StreamTimer(1.0 / (parameters[1] * CONFIG_TIME_S))
            self._timer.start(now_s)
            self._counter = 0
            return telegram(0x06, host)
        return telegram(0x15, host, bytes((41,)))

    def _rotor_header(self) -> bytes:
        block = bytearray(28)
        block[0] = 0x40
        block[4:8] = (123456).to_bytes(4, "big")
        block[8] = self._dimension_code
        block[10:12] = self._load_code.to_bytes(2, "big")
        total = weighted = 0
        for byte in block:
            total = (total + byte) % 65536
            weighted = (weighted + total) % 65536
        return bytes(block) + total.to_bytes(2, "big") + weighted.to_bytes(2, "big")

    def reading(self, force_n: float) -> bytes:
        """See `SerialSensor.reading`; a sensor without a value shows the end of its range."""
        counts = -32768 if math.isnan(force_n) else round(force_n * self._counts_per_n)
        sample = bytes((self._counter,)) + min(max(counts, -32768), 32767).to_bytes(2, "big", signed=True)
        self._counter = (self._counter + 1) % 256
        return sample

    def restart(self, now_s: float, silent_s: float) -> None:
        self._timer.stop()
        self._input = b""
        super().restart(now_s, silent_s)
