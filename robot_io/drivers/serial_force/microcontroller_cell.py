"""A load cell for 20 dollars: HX711 or NAU7802 on a microcontroller, with the firmware of docs/firmware.

The protocol is palpate's own: lines of ASCII text, each followed by `*`, the CRC-16 (CCITT, from FFFF) of the
text as four hexadecimal digits, and LF.

    ?                              what the host sends, alone and without a CRC
    cell 1 nau7802 320*162E        the answer: version of the protocol, converter, samples a second
    17 -123456*B93E                each sample, unasked: counter modulo 256, and counts

A line that has lost or gained a byte is rejected, and so is a sample whose counter does not advance. If the
converter fails, the firmware sends `fault` and a word instead.
"""

import re
from binascii import crc_hqx
from contextlib import suppress
from math import copysign
from typing import Annotated

from pydantic import Field

from palpate.robot_io.drivers.serial_force.line import SerialForceSensor, SerialForceSettings
from palpate.robot_io.drivers.serial_force.stream import LineSplitter, ReadingStream, SensorClock, decode_text
from palpate.robot_io.errors import ProtocolError
from palpate.robot_io.examination import Examinable
from palpate.robot_io.files.file_model import Capacity, Number, Positive

WHO = b"?\n"
VERSION = "1"
# End of the range of a 24 bit converter; the other end is one below its negative.
LARGEST_COUNTS = (1 << 23) - 1

_SAMPLE = re.compile(r"([0-9]{1,3}) (-?[0-9]{1,7})")
_ANSWER_S, _QUESTIONS = 0.3, 4  # a board that is reset by opening its port takes a second to start
_COUNTERS, _AHEAD = 256, 128  # a larger step of the counter counts as a step back
_OLD_SAMPLES = 5  # consecutive old samples that continue from each other: the cell has restarted
_RATE_ERROR = 0.1  # relative error of the converters' own oscillators


def verified_text(line: bytes) -> str:
    """Return the text of a line before its CRC; raise `ProtocolError` if that is wrong or missing.

    Args:
        line: received line.
    """
    text, star, digits = line.rpartition(b"*")
    if not star or digits != b"%04X" % crc_hqx(text, 0xFFFF):
        raise ProtocolError(f"damaged: {line[:40]!r}")
    return decode_text(text)


def parse_sample(line: bytes) -> tuple[int, int]:
    """Parse counter and counts of a line; raise `ProtocolError` if it is damaged, or not a sample.

    Args:
        line: received line.
    """
    match = _SAMPLE.fullmatch(verified_text(line))
    if (
        match is None
        or int(match[1]) >= _COUNTERS
        or not -LARGEST_COUNTS - 1 <= int(match[2]) <= LARGEST_COUNTS
    ):
        raise ProtocolError(f"not a sample: {line[:40]!r}")
    return int(match[1]), int(match[2])


class CellStream(ReadingStream):
    """Forces from lines; a line whose counter repeats or goes back is old, and is ignored.

    If five such lines continue from each other, the cell has restarted. A converter at the end of its range
    shows at least `capacity_n` [N]. `rate_hz` is the sample rate [Hz], by which `sensor_clock` dates samples.
    """

    has_checksums = True
    sensor_clock: SensorClock

    def __init__(
        self, newtons_per_count: float, zero_counts: float, capacity_n: float, rate_hz: float
    ) -> None:
        self._scale, self._zero, self._capacity_n = newtons_per_count, zero_counts, capacity_n
        self._period_s, self.sensor_clock = 1.0 / rate_hz, SensorClock(_RATE_ERROR, _COUNTERS / rate_hz)
        self._lines = LineSplitter()
        self._lines.resynchronize()  # the first line may have lost its beginning
        self._counter: int | None = None
        self._old_counter: int | None = None  # counter of the last ignored sample
        self._old = 0  # number of ignored samples that continue from each other

    def feed(self, data: bytes) -> list[float]:
        samples: list[float] = []
        for line in self._lines.feed(data):
            try:
                counter, counts = parse_sample(line)
            except ProtocolError:
                fault = ""
                with suppress(ProtocolError):
                    fault = verified_text(line)
                if fault.startswith("fault "):
                    self.fault_text = f"the cell says '{fault}'"
                    self.sensor_clock.restart()  # the cell's counter does not advance during a fault
                else:
                    self.rejected += 1
                continue
            if self._is_new(counter):
                self.fault_text = ""
                force_n = (counts - self._zero) * self._scale
                at_end = counts in (LARGEST_COUNTS, -LARGEST_COUNTS - 1)
                force_n = copysign(max(abs(force_n), self._capacity_n), force_n) if at_end else force_n
                samples.append(force_n)
            else:
                self.rejected += 1
        return samples

    def _is_new(self, counter: int) -> bool:
        steps = 1 if self._counter is None else (counter - self._counter) % _COUNTERS
        if not 0 < steps < _AHEAD:
            goes_on = self._old_counter is not None and (counter - self._old_counter) % _COUNTERS == 1
            self._old_counter, self._old = counter, self._old + 1 if goes_on else 1
            if self._old < _OLD_SAMPLES:
                return False
            self.sensor_clock.restart()
        self.sensor_clock.advance(steps * self._period_s)
        self._counter, self._old_counter, self._old = counter, None, 0
        return True


class MicrocontrollerCellSettings(SerialForceSettings):
    """Settings in the robot file."""

    capacity_n: Capacity  # capacity of the load cell [N]
    # Newtons per count, from two known weights or `palpate calibrate force` [N].
    newtons_per_count: Positive
    zero_counts: Number = 0.0  # counts without a load
    # Sample rate [Hz]; the firmware must report the same.
    rate_hz: Annotated[int, Field(ge=1, le=1000, strict=True)]


class MicrocontrollerCell(SerialForceSensor, Examinable):
    """The load cell, on a `serial_line`."""

    name = "microcontroller_cell"
    Settings = MicrocontrollerCellSettings
    _settings: MicrocontrollerCellSettings

    def configure(self) -> None:
        """Identify the cell and listen; raise `DeviceError` on silence or another protocol or rate."""
        settings = self._settings
        answers = (self._ask_line(WHO, _identity, _ANSWER_S) for _ in range(_QUESTIONS))
        if (words := next(filter(None, answers), None)) is None:
            raise self._error("no cell answers; check port, baud rate and firmware")
        version, chip, rate = words
        if version != VERSION:
            raise self._error(f"uses protocol version {version}, but this driver supports version {VERSION}")
        if not rate.isdecimal():
            raise self._error(f"states a rate of '{rate}' samples per second, which is not a number")
        rate_hz = int(rate)
        if rate_hz != settings.rate_hz:
            raise self._error(
                f"the {chip} delivers {rate_hz} samples/s, but the robot file states {settings.rate_hz}"
            )
        self._identified = (
            f"{chip}, {rate_hz} samples/s, load cell of {settings.capacity_n:.4g} N according to the robot "
            "file"
        )
        stream = CellStream(settings.newtons_per_count, settings.zero_counts, settings.capacity_n, rate_hz)
        self._bus.listen(stream, settings.capacity_n)


def _identity(line: bytes) -> list[str] | None:
    """Parse version, converter and rate from a line; None if it is not an answer."""
    try:
        first, *words = verified_text(line).split()
    except (ProtocolError, ValueError):
        return None
    return words if first == "cell" and len(words) == 3 else None
