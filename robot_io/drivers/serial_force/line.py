"""The line that a force sensor hangs on, such as a serial port: one sensor, one reader."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Annotated, ClassVar, Protocol, TypeVar

import numpy as np
import serial
from pydantic import Field

from robot_io.driver import DriverContext
from robot_io.drivers.serial_force.own_time import OwnTime
from robot_io.drivers.serial_force.poll import Poll
from robot_io.drivers.serial_force.reader import ForceSample, SerialReader
from robot_io.drivers.serial_force.text import Stream
from robot_io.errors import DeviceError, DeviceTimeoutError
from robot_io.files.file_model import FileModel, NotNegative
from robot_io.interfaces import Bus
from robot_io.serial_port import close_exclusive, open_exclusively
from robot_io.types import Reading, Status

Answer = TypeVar("Answer")

_LOOK_S = 1e-3  # the thread looks at least this often
_SILENT_SHARE = 0.5  # of the age limit; reported from then on, so that it is known when the limit is reached
_WRITE_S = 0.2  # more than any question takes


class ForceLineSettings(FileModel):
    """What the robot file says; a line adds its own."""

    # From sampling in the sensor to arrival: filter, transmission, latency timer of the USB adapter [s].
    delay_s: Annotated[NotNegative, Field(le=1)] = 0.0


class Port(Protocol):
    """An open end of a line; nothing waits for long."""

    def fileno(self) -> int:
        """Its file."""

    def read(self, size: int, /) -> bytes:
        """What has come, at most `size` bytes or one datagram."""

    def write(self, data: bytes, /) -> object:
        """Send."""


class ForceLine(Bus):
    """A line with one force sensor.

    Attributes:
        sample: newest reading as of the last poll; None before the first.
    """

    Settings: ClassVar[type[ForceLineSettings]]
    reader_type: ClassVar[type[SerialReader]] = SerialReader
    _own: ForceLineSettings

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._own = context.settings_as(self.Settings, settings)
        self._clock = context.clock
        self._silent_s = _SILENT_SHARE * context.robot_file.limits.force_age_s
        self._port: Port | None = None
        self._reader: SerialReader | None = None
        self._capacity_n = float("inf")
        self.sample: ForceSample | None = None

    @property
    @abstractmethod
    def label(self) -> str:
        """What to call it in messages."""

    @abstractmethod
    def _close_port(self) -> None:
        """Close the port that is open."""

    def close(self) -> None:
        """End the reading and close the port. Can be called again."""
        if self._reader is not None:
            self._reader.stop()
            self._reader = None
        if self._port is not None:
            self._close_port()
            self._port = None

    def write(self, data: bytes) -> None:
        """Send bytes to the sensor. DeviceError: the port failed."""
        try:
            self._opened().write(data)
        except OSError as error:
            raise DeviceError(f"{self.label}: cannot be written to ({error})") from error

    def ask(
        self, question: bytes, understand: Callable[[bytes], Answer | None], timeout_s: float
    ) -> Answer | None:
        """Send `question`, then hand what comes to `understand` until it returns an answer, or time is up.

        Only before `listen`. DeviceError: the port failed.
        """
        self.write(question)
        end_s = self._clock.now_s() + timeout_s
        while self._clock.now_s() < end_s:
            self._clock.sleep_until(self._clock.now_s() + _LOOK_S)
            try:
                data = self._opened().read(4096)
            except OSError as error:
                raise DeviceError(f"{self.label}: cannot be read ({error})") from error
            answer = understand(data) if data else None
            if answer is not None:
                return answer
        return None

    def listen(
        self,
        stream: Stream,
        capacity_n: float,
        held_back_s: float = 0.0,
        *,
        has_checksums: bool = False,
        own_time: OwnTime | None = None,
        poll: Poll | None = None,
    ) -> None:
        """From now on all bytes are readings, made by `stream`; from `capacity_n` on [N] they are saturated.

        `held_back_s`, `has_checksums` and `own_time` are as for `SerialReader`; each reading is asked for by
        `poll`, if there is one.

        DeviceError: the port is not open.
        """
        self._capacity_n = capacity_n
        self._reader = self.reader_type(
            self._opened().fileno(),
            stream,
            self._clock,
            capacity_n,
            held_back_s,
            has_checksums=has_checksums,
            own_time=own_time,
            poll=poll,
        )
        self._reader.start()

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`; never waits.

        DeviceError: the port failed, or the sensor says that it has; DeviceTimeoutError: it is silent, or has
        sent data but no valid reading yet.
        """
        reader = self._reader
        if reader is None:
            return
        self.sample = reader.newest
        if reader.failure or reader.complaint:
            raise DeviceError(f"{self.label}: {reader.failure or reader.complaint}")
        if self.sample is None:
            if reader.rejected:
                raise DeviceTimeoutError(
                    f"{self.label}: {reader.rejected} lines or telegrams and no reading yet: do driver, "
                    "baud rate, pattern and unit fit the sensor?"
                )
            return
        age_s = self._clock.now_s() - self.sample.arrived_at_s
        if age_s > self._silent_s:
            late_s = self.sample.late_s
            late = f"; the last one came {late_s * 1e3:.1f} ms late" if late_s > self._silent_s else ""
            rejected = f"; {reader.rejected} were damaged so far" if reader.rejected else ""
            raise DeviceTimeoutError(f"{self.label}: no reading for {age_s * 1e3:.1f} ms{late}{rejected}")

    def flush(self, deadline_s: float) -> None:
        """See `Bus.flush`; nothing is sent to a sensor in a tick."""

    def reading(self, *, reversed_sign: bool) -> Reading:
        """The newest sample; `reversed_sign`: the sensor counts tension as positive."""
        if self.sample is None:
            return Reading(np.full(1, np.nan), -np.inf, Status.STALE)
        force_n, arrived_at_s, _ = self.sample
        status = Status.SATURATED if abs(force_n) >= self._capacity_n else Status.OK
        value = np.array([-force_n if reversed_sign else force_n])
        return Reading(value, arrived_at_s - self._own.delay_s, status)

    def _opened(self) -> Port:
        if self._port is None:
            raise DeviceError(f"{self.label}: not open")
        return self._port


class SerialLineSettings(ForceLineSettings):
    """What the robot file says."""

    # Better /dev/serial/by-id/... than /dev/ttyUSB0.
    port: Annotated[str, Field(min_length=1, max_length=300)]
    baud_rate: Annotated[int, Field(gt=0, le=12_000_000, strict=True)]


class SerialLine(ForceLine):
    """A serial port, opened exclusively."""

    name = "serial_line"
    Settings = SerialLineSettings
    _own: SerialLineSettings
    _port: serial.Serial | None

    @property
    def label(self) -> str:
        """See `ForceLine.label`."""
        return f"serial port {self._own.port}"

    @property
    def baud_rate(self) -> int:
        """By the robot file [bit/s]."""
        return self._own.baud_rate

    def configure(self) -> None:
        """Open the port. DeviceError: it is not there, not permitted, or in use."""
        self._port = open_exclusively(self._own.port, self._own.baud_rate, _WRITE_S)
        self._port.reset_input_buffer()

    def _close_port(self) -> None:
        if self._port is not None:
            close_exclusive(self._port)
