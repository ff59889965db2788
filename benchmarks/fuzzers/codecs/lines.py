"""Sensors that write lines: every accepted value must stand in the stream as a number."""

import re

import numpy as np

from robot_io.drivers.serial_force.force_lines import pattern_stream
from robot_io.drivers.serial_force.loadstar import loadstar_stream
from robot_io.drivers.serial_force.mark10 import Mark10Stream
from robot_io.drivers.serial_force.microcontroller_cell import CellStream
from sim_backend.emulators.serial.cell import crc, line

from ..fuzzer import StreamFuzzer


class _LinesFuzzer(StreamFuzzer):
    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`: the number must be the first word of a line."""
        words = (line.split()[:1] for line in re.split(rb"[\r\n]", self.seen))
        return not any(_is(word[0], accepted) for word in words if word)


def _is(word: bytes, value: object) -> bool:
    try:
        return float(word) == value
    except ValueError:
        return False


class LoadstarFuzzer(_LinesFuzzer):
    """The continuous mode, in newtons."""

    name = "loadstar"

    def __init__(self) -> None:
        super().__init__(loadstar_stream(1.0, 100.0))

    def frame(self, rng: np.random.Generator) -> bytes:
        return f"{rng.normal(scale=30.0):12.4f}\r\n".encode()


class Mark10Fuzzer(_LinesFuzzer):
    """A gauge that is asked, in newtons."""

    name = "mark10"

    def __init__(self) -> None:
        super().__init__(Mark10Stream("N", 100.0))

    def frame(self, rng: np.random.Generator) -> bytes:
        return f"{rng.normal(scale=30.0):.2f} N\r\n".encode()

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`: the number must stand before the unit, and nothing else in its line."""
        whole = (line.strip().split(b" ") for line in re.split(rb"[\r\n]", self.seen))
        return not any(words[1:] == [b"N"] and _is(words[0], accepted) for words in whole)


class PatternFuzzer(_LinesFuzzer):
    """A gauge that names its unit."""

    name = "force_lines"

    def __init__(self) -> None:
        super().__init__(pattern_stream(r"\s*(?P<value>[-+]?[\d.]+) (?P<unit>N)", None, 1.0, 1e9))

    def frame(self, rng: np.random.Generator) -> bytes:
        return f"{rng.normal(scale=30.0):.3f} N\r\n".encode()


class CellFuzzer(StreamFuzzer):
    """A load cell on a microcontroller; the CRC is made again by its emulator."""

    name = "microcontroller_cell"

    def __init__(self) -> None:
        super().__init__(CellStream(1.0, 0.0, 100.0))
        self._counter = 0

    def frame(self, rng: np.random.Generator) -> bytes:
        self._counter = (self._counter + 1) % 256
        return line(f"{self._counter} {int(rng.integers(-(1 << 23), 1 << 23))}")

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        lines = (one.rpartition(b"*") for one in re.split(rb"[\r\n]", self.seen))
        sound = (text.split() for text, _, digits in lines if digits == b"%04X" % crc(text))
        return not any(_is(words[-1], accepted) for words in sound if words)
