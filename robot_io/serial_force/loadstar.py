"""Loadstar DI-100 and DI-1000 load cell interfaces: ASCII commands and lines of readings.

Source: Loadstar Sensors, "DI-100U / DI-1000U Command Set" and "DI-1000HS-1K Output Formats"
    (loadstarsensors.com): a
command ends with CR, an answer with CR LF; CR alone is answered with A and ends a stream; readings come as
decimal numbers in the unit that UNITS tells.
"""

import re

from robot_io.errors import ProtocolError
from robot_io.serial_force.framing import LineSplitter
from robot_io.serial_force.units import newtons_per

PING = b"\r"
PONG = "A"
ASK_MODEL = b"MODEL\r"
ASK_UNITS = b"UNITS\r"
ASK_CAPACITY = b"LC\r"
TARE = b"CT0\r"
STREAM = b"WC\r"
STOP = b"\r"
MODELS = ("DI-1000", "DI-100")

_NUMBER = re.compile(r"[+-]?([0-9]{1,9}(\.[0-9]{0,9})?|\.[0-9]{1,9})")


def text_of(line: bytes) -> str:
    """A line as text, free of blanks around it.

    Raises:
        ProtocolError: it holds something that is not printable ASCII.
    """
    if not all(32 <= byte < 127 or byte == 9 for byte in line):
        raise ProtocolError(f"not a line of text: {line[:40]!r}")
    return line.decode("ascii").strip()


def model_of(answer: str) -> str:
    """Which interface answered MODEL.

    Raises:
        ProtocolError: it is none that is known here.
    """
    for model in MODELS:
        if model in answer.upper():
            return model
    raise ProtocolError(f"model '{answer[:40]}' is not a {' or '.join(MODELS)}")


def unit_of(answer: str) -> float:
    """Newtons in one unit of the readings, from the answer to UNITS (with or without that word before it).

    Raises:
        ProtocolError: it is not a unit of force.
    """
    words = answer.split()
    return newtons_per(words[-1] if words else "")


def number_of(text: str) -> float:
    """A decimal number as the interface writes it.

    Raises:
        ProtocolError: it is not one.
    """
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        raise ProtocolError(f"not a number: '{text[:40]}'")
    return float(text)


class LoadstarStream:
    """Readings of the continuous mode.

    Args:
        newtons_per_unit: newtons in one unit of the readings.
        capacity_n: what the sensor can bear [N]; twice that is not believed to be a reading.
    """

    def __init__(self, newtons_per_unit: float, capacity_n: float) -> None:
        self._lines = LineSplitter()
        self._factor = newtons_per_unit
        self._largest_n = 2.0 * capacity_n
        self._lines.resynchronise()
        self._bad = 0

    @property
    def rejected(self) -> int:
        """Lines that were not readings."""
        return self._bad + self._lines.dropped

    def feed(self, data: bytes) -> list[float]:
        """See `Stream.feed`."""
        samples: list[float] = []
        for line in self._lines.feed(data):
            try:
                force_n = number_of(text_of(line)) * self._factor
            except ProtocolError:
                self._bad += 1
                continue
            if abs(force_n) <= self._largest_n:
                samples.append(force_n)
            else:
                self._bad += 1
        return samples
