"""ATI's Raw Data Transfer as bytes: a request of 8 bytes, and records of 36, one in a datagram.

All values are big-endian. A record counts itself and the measurement that it holds, so that one that comes
twice, late or out of order is told. Ethernet's CRC and UDP's checksum let no flipped bit through.

Sources: ATI 9620-05-NET FT, "UDP Interface Using RDT"; ATI 9610-05-Ethernet Axia, "Status Code". The names of
bits are Axia's, and 17 is the older Net Box's. Others mean something else there, such as 30 an error of its
processor: so every one that says error stops, and is told as a number too.
"""

import struct
from typing import Final, NamedTuple

from robot_io.drivers.serial_force.own_time import OwnTime
from robot_io.drivers.servo.stream import bit_names
from robot_io.errors import ProtocolError

_REQUEST: Final = struct.Struct(">HHI")
_RECORD: Final = struct.Struct(">3I6i")
_HEADER: Final = 0x1234
STOP: Final = _REQUEST.pack(_HEADER, 0, 0)
START: Final = _REQUEST.pack(_HEADER, 2, 0)  # at once, one record in a datagram, until it is told to stop
RECORD_SIZE: Final = _RECORD.size

_LARGEST_COUNTS: Final = (1 << 31) - 1
_NO_ERROR: Final = 1 << 16 | 1 << 31  # a monitor condition that was latched; any of them
_STATUS: Final = {
    1 << 0: "temperature",
    1 << 1: "supply voltage",
    1 << 2: "broken gage",
    1 << 3: "busy",
    1 << 5: "other error",
    1 << 7: "calibration not accessible",
    1 << 17: "transducer saturated",
    1 << 27: "gage out of range",
    1 << 28: "simulated error",
    1 << 29: "calibration checksum",
    1 << 30: "force or torque out of range",
}
_COUNTERS: Final = 1 << 32
_OLD_RECORDS = 50  # in a row are more than any network repeats,
_OLD_BEGINNING, _BEGINNING = 3, 20  # and so many of the first records that there are, long after them


class Record(NamedTuple):
    """One record."""

    sequence: int  # of the records
    measurement: int  # of the sensor's own measurements
    status: int  # bits
    counts: tuple[int, ...]  # forces and torques along x, y, z


def decode_record(datagram: bytes) -> Record:
    """The record in a datagram. ProtocolError: it has another size."""
    if len(datagram) != RECORD_SIZE:
        raise ProtocolError(f"a record has {RECORD_SIZE} bytes, this one {len(datagram)}")
    sequence, measurement, status, *counts = _RECORD.unpack(datagram)
    return Record(sequence, measurement, status, tuple(counts))


def status_problem(status: int) -> str:
    """What a status says is wrong, by name, or nothing."""
    errors = status & ~_NO_ERROR
    if errors or status == 1 << 31:
        return f"{bit_names(errors, _STATUS) if errors else 'error'} (status {status:#010x})"
    return ""


class NetFtStream:
    """Forces of one axis ("x", "y" or "z") from datagrams, `rate_hz` of them a second [Hz]; see `Stream`.

    What counts as rejected are datagrams that were no records, and records that were not new.
    """

    def __init__(self, newtons_per_count: float, axis: str, rate_hz: float) -> None:
        self._scale, self._axis, self._period_s = newtons_per_count, "xyz".index(axis), 1.0 / rate_hz
        self._last: Record | None = None
        self._old = 0  # in a row
        self.complaint, self.own_time = "", OwnTime()
        self.rejected = 0

    def feed(self, data: bytes) -> list[float]:
        """The force in one datagram, if it has a new one [N]."""
        try:
            record = decode_record(data)
        except ProtocolError:
            self.rejected += 1
            return []
        if not self._is_new(record):
            return []
        counts, problem = record.counts[self._axis], status_problem(record.status)
        if not problem and abs(counts) >= _LARGEST_COUNTS:
            problem = "counts at their end"
        self._last, self.complaint = record, f"the sensor says '{problem}'" if problem else ""
        return [] if problem else [counts * self._scale]

    def _is_new(self, record: Record) -> bool:
        last = self._last or Record(record.sequence - 1, record.measurement - 1, 0, ())
        steps = (record.sequence - last.sequence) % _COUNTERS
        if 0 < steps < _COUNTERS // 2 and record.measurement != last.measurement:
            self._old = 0
            self.own_time.goes_on(steps * self._period_s)
            return True
        self.rejected += 1
        self._old += 1
        is_beginning = record.sequence <= _BEGINNING and last.sequence > 2 * _BEGINNING
        if self._old >= (_OLD_BEGINNING if is_beginning else _OLD_RECORDS):
            self.complaint = "the sensor has begun to count anew, or measures nothing new: has it restarted?"
        return False
