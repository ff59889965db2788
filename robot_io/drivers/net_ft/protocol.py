"""ATI's Raw Data Transfer as bytes: a request of 8 bytes, and records of 36, one in a datagram.

All values are big-endian. A record counts itself and the measurement that it holds, so that one that comes
twice, late or out of order is told. Ethernet's CRC and UDP's checksum let no flipped bit through.

Sources: ATI 9620-05-NET FT, "UDP Interface Using RDT"; ATI 9610-05-Ethernet Axia, "Status Code". The bits are
Axia's; where those of the older Net Box differ, a message has the status as a number beside the name.
"""

import struct
from math import copysign
from typing import Final, NamedTuple

from robot_io.drivers.servo.stream import bit_names
from robot_io.errors import ProtocolError

_REQUEST: Final = struct.Struct(">HHI")
_RECORD: Final = struct.Struct(">3I6i")
_HEADER: Final = 0x1234
STOP: Final = _REQUEST.pack(_HEADER, 0, 0)
START: Final = _REQUEST.pack(_HEADER, 2, 0)  # at once, one record in a datagram, until it is told to stop
RECORD_SIZE: Final = _RECORD.size

AXES: Final = {"x": 0, "y": 1, "z": 2}
_LARGEST_COUNTS: Final = (1 << 31) - 1
_OUT_OF_RANGE: Final = 1 << 27 | 1 << 30  # of a gage; of a force or torque
_NO_ERROR: Final = 1 << 16 | 1 << 31  # a monitor condition that was latched; any of them
_STATUS: Final = {
    1 << 0: "temperature",
    1 << 1: "supply voltage",
    1 << 2: "broken gage",
    1 << 3: "busy",
    1 << 5: "other error",
    1 << 7: "calibration not accessible",
    1 << 28: "simulated error",
    1 << 29: "calibration checksum",
}
_COUNTERS: Final = 1 << 32
_OLD_RECORDS = 50  # in a row are more than any network repeats


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
    """What a status says is wrong, by name, or nothing; a range that is exceeded is not told here."""
    errors = status & ~(_OUT_OF_RANGE | _NO_ERROR)
    if errors or status == 1 << 31:
        return f"{bit_names(errors, _STATUS) if errors else 'error'} (status {status:#010x})"
    return ""


class NetFtStream:
    """Forces of one axis from datagrams; see `Stream`.

    Args:
        newtons_per_count: what one count is [N].
        axis: "x", "y" or "z".
        capacity_n: what is shown at least where the sensor says that its range is exceeded [N].

    Attributes:
        complaint: see `Stream`.
        rejected: datagrams that were no records, and records that were not new.
    """

    def __init__(self, newtons_per_count: float, axis: str, capacity_n: float) -> None:
        self._scale, self._axis, self._capacity_n = newtons_per_count, AXES[axis], capacity_n
        self._last: Record | None = None
        self._old = 0  # in a row
        self.complaint = ""
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
        self._last, self.complaint = record, ""
        problem = status_problem(record.status)
        if problem:
            self.complaint = f"the sensor says '{problem}'"
            return []
        return [self._force_n(record)]

    def _is_new(self, record: Record) -> bool:
        last = self._last
        if last is None or (
            0 < (record.sequence - last.sequence) % _COUNTERS < _COUNTERS // 2
            and record.measurement != last.measurement
        ):
            self._old = 0
            return True
        self.rejected += 1
        self._old += 1
        if self._old >= _OLD_RECORDS:
            self.complaint = "the sensor has begun to count anew, or measures nothing new: has it restarted?"
        return False

    def _force_n(self, record: Record) -> float:
        counts = record.counts[self._axis]
        force_n = counts * self._scale
        at_end = record.status & _OUT_OF_RANGE or abs(counts) >= _LARGEST_COUNTS
        return copysign(max(abs(force_n), self._capacity_n), force_n) if at_end else force_n
