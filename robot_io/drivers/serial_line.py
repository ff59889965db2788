"""A serial port with one force sensor at its other end."""

from collections.abc import Callable, Mapping
from typing import Annotated, ClassVar, TypeVar

import numpy as np
import serial
from pydantic import Field

from robot_io.driver import DriverContext
from robot_io.errors import DeviceError, DeviceTimeoutError
from robot_io.exclusive_port import close_exclusive, open_exclusively
from robot_io.files.file_model import FileModel, NotNegative
from robot_io.interfaces import Bus
from robot_io.serial_force import ForceSample, SerialReader, Stream
from robot_io.types import Reading, Status

Answer = TypeVar("Answer")

_SILENT_SHARE = 0.5  # of the age limit; said from then on, so that it is known when the limit is reached
_LOOK_S = 1e-3
_WRITE_S = 0.2  # more than any question takes


class SerialLineSettings(FileModel):
    """What the robot file says.

    Attributes:
        port: such as /dev/ttyUSB0, or better /dev/serial/by-id/...
        baud_rate: bits a second.
        delay_s: from the sampling in the sensor until its reading has arrived [s]: filter, transmission, and
            the latency timer of the USB adapter.
    """

    port: Annotated[str, Field(min_length=1, max_length=300)]
    baud_rate: Annotated[int, Field(gt=0, le=12_000_000, strict=True)]
    delay_s: Annotated[NotNegative, Field(le=1)] = 0.0


class SerialLine(Bus):
    """A serial port, opened so that nobody else can, and read by a thread of its own.

    Args:
        settings: as `SerialLineSettings`.
        context: clock and robot file.

    Attributes:
        sample: newest reading as of the last poll; None before the first.
    """

    name: ClassVar[str] = "serial_line"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._own = context.settings_as(SerialLineSettings, settings)
        self._clock = context.clock
        self._silent_s = _SILENT_SHARE * context.robot_file.limits.force_age_s
        self._port: serial.Serial | None = None
        self._reader: SerialReader | None = None
        self.sample: ForceSample | None = None

    @property
    def label(self) -> str:
        """What to call it in messages."""
        return f"serial port {self._own.port}"

    def configure(self) -> None:
        """Open the port.

        Raises:
            DeviceError: it is not there, not permitted, or in use.
        """
        self._port = open_exclusively(self._own.port, self._own.baud_rate, _WRITE_S)
        self._port.reset_input_buffer()

    def close(self) -> None:
        """End the reading and close the port. Can be called again."""
        if self._reader is not None:
            self._reader.stop()
            self._reader = None
        port, self._port = self._port, None
        if port is not None:
            close_exclusive(port)

    def write(self, data: bytes) -> None:
        """Send bytes to the sensor.

        Raises:
            DeviceError: the port failed.
        """
        try:
            self._opened().write(data)
        except (serial.SerialException, OSError) as error:
            raise DeviceError(f"{self.label}: cannot be written to ({error})") from error

    def ask(
        self, question: bytes, understand: Callable[[bytes], Answer | None], timeout_s: float
    ) -> Answer | None:
        """Send `question` and hand what comes to `understand` until it has an answer, or time is up.

        Only before `listen`.

        Raises:
            DeviceError: the port failed.
        """
        self.write(question)
        end_s = self._clock.now_s() + timeout_s
        while self._clock.now_s() < end_s:
            self._clock.sleep_until(self._clock.now_s() + _LOOK_S)
            try:
                data = self._opened().read(4096)
            except (serial.SerialException, OSError) as error:
                raise DeviceError(f"{self.label}: cannot be read ({error})") from error
            answer = understand(data) if data else None
            if answer is not None:
                return answer
        return None

    def listen(self, stream: Stream) -> None:
        """From now on all bytes are readings, which `stream` makes of them.

        Raises:
            DeviceError: the port is not open.
        """
        self._reader = SerialReader(self._opened().fileno(), stream, self._clock)
        self._reader.start()

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`; never waits.

        Raises:
            DeviceError: the port failed.
            DeviceTimeoutError: the sensor has fallen silent, or speaks and has shown no reading yet.
        """
        reader = self._reader
        if reader is None:
            return
        self.sample = reader.newest
        if reader.failure is not None:
            raise DeviceError(f"{self.label}: {reader.failure}")
        if self.sample is None:
            if reader.rejected:
                raise DeviceTimeoutError(
                    f"{self.label}: {reader.rejected} lines or telegrams and no reading yet: do driver, "
                    "baud rate, pattern and unit fit the sensor?"
                )
            return
        age_s = self._clock.now_s() - self.sample.arrived_at_s
        if age_s > self._silent_s:
            rejected = f"; {reader.rejected} were damaged so far" if reader.rejected else ""
            raise DeviceTimeoutError(f"{self.label}: no reading for {age_s * 1e3:.1f} ms{rejected}")

    def flush(self, deadline_s: float) -> None:
        """See `Bus.flush`; nothing is sent to a sensor in a tick."""

    def reading(self, *, reversed_sign: bool, capacity_n: float) -> Reading:
        """The sample as a force sensor hands it out.

        Args:
            reversed_sign: whether the sensor counts tension as positive.
            capacity_n: from this force on it is saturated [N].
        """
        if self.sample is None:
            return Reading(np.full(1, np.nan), -np.inf, Status.STALE)
        force_n, arrived_at_s = self.sample
        status = Status.SATURATED if abs(force_n) >= capacity_n else Status.OK
        value = np.array([-force_n if reversed_sign else force_n])
        return Reading(value, arrived_at_s - self._own.delay_s, status)

    def _opened(self) -> serial.Serial:
        if self._port is None:
            raise DeviceError(f"{self.label}: not open")
        return self._port
