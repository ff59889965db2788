"""ATI's Net F/T and Ethernet Axia sensors: protocol, configuration page, line and sensor.

Raw Data Transfer (RDT) uses requests of 8 bytes and records of 36 bytes, one per datagram. All values are
big-endian. A record has a counter of its own and of its measurement, so that repeated, late and reordered
records are detected. Ethernet's CRC and UDP's checksum detect flipped bits.

Sources: ATI 9620-05-NET FT, "UDP Interface Using RDT"; ATI 9610-05-Ethernet Axia, "Status Code". Bit names
are Axia's, and 17 is the older Net Box's. Some bits have another meaning there, such as 30 (an error of its
processor). So every error bit stops the arm and is also reported as a number.

The active configuration is on the page `netftapi2.xml` of its web server (ATI 9620-05-NET FT, "XML Pages").
Records do not show a change of scale, bias, filter or tool frame, so that the page is read again before and
after each run.
"""

import os
import re
import socket
import struct
from contextlib import suppress
from http.client import OK, HTTPConnection, HTTPException
from math import isfinite
from typing import Annotated, Final, NamedTuple

from pydantic import AfterValidator, Field

from palpate.robot_io.drivers.serial_force.line import (
    AxisForceSettings,
    ForceLine,
    ForceLineSettings,
    SerialForceSensor,
    SerialReader,
)
from palpate.robot_io.drivers.serial_force.stream import ReadingStream, SensorClock, check_unit, newtons_per
from palpate.robot_io.drivers.servo.stream import bit_names
from palpate.robot_io.errors import DeviceError, ProtocolError
from palpate.robot_io.examination import Examinable
from palpate.robot_io.files.file_model import Positive, matching

_REQUEST: Final = struct.Struct(">HHI")
_RECORD: Final = struct.Struct(">3I6i")
_HEADER: Final = 0x1234
STOP: Final = _REQUEST.pack(_HEADER, 0, 0)
START: Final = _REQUEST.pack(_HEADER, 2, 0)  # real-time streaming, one record per datagram, until stopped
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
_OLD_RECORDS = 50  # consecutive old records that show a restart, because no network repeats so many;
_OLD_BEGINNING, _BEGINNING = 3, 20  # or fewer, if they are numbered like the first records of a stream


class RdtRecord(NamedTuple):
    """One record."""

    sequence: int  # of the records
    measurement: int  # of the sensor's own measurements
    status: int  # bits
    counts: tuple[int, ...]  # forces and torques along x, y, z


def decode_record(datagram: bytes) -> RdtRecord:
    """Return the record in a datagram; raise `ProtocolError` for another size.

    Args:
        datagram: received datagram.
    """
    if len(datagram) != RECORD_SIZE:
        raise ProtocolError(f"a record must have {RECORD_SIZE} bytes, but this one has {len(datagram)}")
    sequence, measurement, status, *counts = _RECORD.unpack(datagram)
    return RdtRecord(sequence, measurement, status, tuple(counts))


class NetFtStream(ReadingStream):
    """Forces of one axis ("x", "y" or "z") from datagrams, `rate_hz` of them a second [Hz].

    Datagrams that are not records, and records that are not new, are rejected.
    """

    has_checksums = True
    sensor_clock: SensorClock

    def __init__(self, newtons_per_count: float, axis: str, rate_hz: float) -> None:
        self._scale, self._axis, self._period_s = newtons_per_count, "xyz".index(axis), 1.0 / rate_hz
        self._last: RdtRecord | None = None
        self._old = 0  # in a row
        self.sensor_clock = SensorClock()

    def feed(self, data: bytes) -> list[float]:
        """Decode the force in one datagram; nothing if it is not new, or if the sensor reports an error.

        Args:
            data: bytes of one datagram.

        Returns:
            At most one force, in the sensor's sign [N].
        """
        try:
            record = decode_record(data)
        except ProtocolError:
            self.rejected += 1
            return []
        last = self._last or RdtRecord(record.sequence - 1, record.measurement - 1, 0, ())
        steps = (record.sequence - last.sequence) % _COUNTERS
        if not 0 < steps < _COUNTERS // 2 or record.measurement == last.measurement:
            self.rejected += 1
            self._old += 1
            is_beginning = record.sequence <= _BEGINNING and last.sequence > 2 * _BEGINNING
            if self._old >= (_OLD_BEGINNING if is_beginning else _OLD_RECORDS):
                self.fault_text = (
                    "the sensor's counter restarted, or its readings do not change; has it restarted?"
                )
            return []
        self._old = 0
        self.sensor_clock.advance(steps * self._period_s)
        counts, errors, problem = record.counts[self._axis], record.status & ~_NO_ERROR, ""
        if errors or record.status == 1 << 31:
            problem = f"{bit_names(errors, _STATUS) if errors else 'error'} (status {record.status:#010x})"
        elif abs(counts) >= _LARGEST_COUNTS:
            problem = "counts at the end of their range"
        self._last, self.fault_text = record, f"the sensor says '{problem}'" if problem else ""
        return [] if problem else [counts * self._scale]


PAGE: Final = "/netftapi2.xml"
_LARGEST_PAGE = 262_144  # bytes
_SETTINGS: Final = re.compile(r"<((?:s?cfg|set|comrdt)\w{0,20})>([ -~]{0,200})</\1>")
_PATIENCE_S = 2.0


class NetFtConfiguration(NamedTuple):
    """Configuration that a sensor reports."""

    product: str  # name of the product
    counts_per_force: float  # counts of one `unit`
    unit: str  # of its forces
    rate_hz: int  # records per second
    is_streaming: bool  # whether records are sent at all
    settings: dict[str, str]  # everything on which forces depend, by its name on the page


def parse_configuration(page: bytes) -> NetFtConfiguration:
    """Return the configuration on a page; raise `ProtocolError` if a value is missing or invalid.

    Args:
        page: netftapi2.xml.
    """
    text = page.decode("utf-8", "replace")
    try:
        configuration = NetFtConfiguration(
            product=_value(text, "prodname", "Net F/T"),
            counts_per_force=float(_value(text, "cfgcpf")),
            unit=_value(text, "scfgfu"),
            rate_hz=int(_value(text, "comrdtrate")),
            is_streaming=_value(text, "comrdte").lower() == "enabled",
            settings=dict(_SETTINGS.findall(text)),
        )
    except ValueError as error:
        raise ProtocolError(f"not a number: {error}") from error
    newtons_per(configuration.unit)
    if not (configuration.counts_per_force > 0.0 and isfinite(configuration.counts_per_force)):
        raise ProtocolError(f"{configuration.counts_per_force:g} counts per {configuration.unit}")
    if configuration.rate_hz < 1:
        raise ProtocolError(f"{configuration.rate_hz} records per second")
    return configuration


def _value(text: str, name: str, default: str | None = None) -> str:
    match = re.search(rf"<{name}>\s*([ -~]{{1,60}}?)\s*</{name}>", text)
    if match is None and default is None:
        raise ProtocolError(f"'{name}' is missing")
    return match[1] if match else str(default)


_LARGEST_DATAGRAM = 2048  # bytes
_AT_ONCE = 1000  # most datagrams that are read at once

_Port = Annotated[int, Field(ge=1, le=65_535, strict=True)]


class NetFtLineSettings(ForceLineSettings):
    """Settings in the robot file."""

    # As delivered, 192.168.1.1.
    host: Annotated[str, matching("[A-Za-z0-9._-]{1,253}", "its address alone, such as 192.168.1.1")]
    rdt_port: _Port = 49_152
    http_port: _Port = 80


class DatagramReader(SerialReader):
    """Stream reader that passes on each datagram separately."""

    def _receive(self) -> list[bytes]:
        datagrams: list[bytes] = []
        with suppress(BlockingIOError):
            while len(datagrams) < _AT_ONCE:
                datagrams.append(os.read(self._file_descriptor, _LARGEST_DATAGRAM))
        return datagrams


class _Socket:
    """Socket that receives from one sender, as a port."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((host, port))
        except (OSError, UnicodeError):
            self._socket.close()
            raise
        self.fileno, self.close = self._socket.fileno, self._socket.close

    def read(self, size: int) -> bytes:
        """Read one datagram; none if none has come, or no program receives at the sensor's port."""
        with suppress(BlockingIOError, ConnectionRefusedError):
            return self._socket.recv(size)
        return b""

    def write(self, data: bytes) -> None:
        """Send a datagram; ignore a "connection refused", which refers to an earlier datagram."""
        with suppress(ConnectionRefusedError):
            self._socket.send(data)


class NetFtLine(ForceLine):
    """Line of one sensor; datagrams of other hosts are ignored."""

    name = "net_ft_line"
    Settings = NetFtLineSettings
    reader_type = DatagramReader
    _settings: NetFtLineSettings
    _port: _Socket | None

    @property
    def label(self) -> str:
        return f"Net F/T {self._settings.host}"

    def configure(self) -> None:
        """Open a socket; raise `DeviceError` if the host has no address or cannot be reached."""
        try:
            self._port = _Socket(self._settings.host, self._settings.rdt_port)
        except (OSError, UnicodeError) as error:  # the latter if the text cannot be a host name
            raise DeviceError(f"{self.label}: cannot be reached ({error})") from error

    def read_configuration(self) -> NetFtConfiguration:
        """Read the configuration from the sensor's web server; raise `DeviceError` without a valid one."""
        host, port = self._settings.host, self._settings.http_port
        where = f"http://{host}:{port}{PAGE}"
        connection = HTTPConnection(host, port, timeout=_PATIENCE_S)
        try:
            connection.request("GET", PAGE)
            answer = connection.getresponse()
            page = answer.read(_LARGEST_PAGE) if answer.status == OK else b""
        except (OSError, HTTPException) as error:
            raise DeviceError(
                f"{where}: no answer ({error}); check power, cable, host and this machine's address"
            ) from error
        finally:
            connection.close()
        if answer.status != OK:
            raise DeviceError(f"{where}: answers '{answer.status} {answer.reason}': is it a Net F/T sensor?")
        try:
            return parse_configuration(page)
        except ProtocolError as error:
            raise DeviceError(f"{where}: is not the configuration of a Net F/T sensor: {error}") from error

    def _close_port(self) -> None:
        if self._port is not None:
            self._port.close()


_ANSWER_S, _REQUESTS = 0.2, 3
_AGREE = 1e-6  # largest relative difference between two equal scales


class NetFtSettings(AxisForceSettings):
    """Settings in the robot file; the sensor's active configuration must agree."""

    counts_per_force: Positive  # counts of one `unit`
    unit: Annotated[str, AfterValidator(check_unit)] = "N"


class NetFt(SerialForceSensor, Examinable):
    """One axis of the sensor, on a `net_ft_line`."""

    name = "net_ft"
    Settings = NetFtSettings
    line_type = NetFtLine
    end_of_stream = STOP
    _settings: NetFtSettings
    _bus: NetFtLine

    def configure(self) -> None:
        """Start the records; raise `DeviceError` if none come, or the sensor's configuration differs."""
        settings, configuration = self._settings, self._bus.read_configuration()
        newtons_per_count = newtons_per(configuration.unit) / configuration.counts_per_force
        stated = newtons_per(settings.unit) / settings.counts_per_force
        if not abs(newtons_per_count / stated - 1.0) <= _AGREE:
            raise self._error(
                f"counts {configuration.counts_per_force:.10g} for 1 {configuration.unit}, but the "
                f"robot file states {settings.counts_per_force:.10g} for 1 {settings.unit}, so another "
                "configuration is active"
            )
        if not configuration.is_streaming:
            raise self._error("RDT is disabled; enable it on the sensor's page 'Communications'")
        tries = range(_REQUESTS)  # a request may be lost
        if not any(self._bus.ask(START, lambda d: len(d) == RECORD_SIZE or None, _ANSWER_S) for _ in tries):
            raise self._error("sends no records; check rdt_port, firewall and other programs")
        self._configured = configuration.settings
        device = f"{configuration.product}, {configuration.rate_hz} records/s"
        self._identified = f"{device}, {settings.axis} axis, {settings.capacity_n:.4g} N"
        stream = NetFtStream(newtons_per_count, settings.axis, configuration.rate_hz)
        self._bus.listen(stream, settings.capacity_n)

    def activate(self) -> None:
        """Refuse a sensor that somebody has changed since it was configured."""
        self.verify()

    def verify(self) -> None:
        for name, value in self._bus.read_configuration().settings.items():
            before = self._configured.get(name, "")
            if value != before:
                raise self._error(
                    f"its configuration has changed: '{name}' was '{before}' and is '{value}'; "
                    "forces measured since then may be wrong; restore the setting, and start again"
                )
