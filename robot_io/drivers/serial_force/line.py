"""Line of a force sensor: the thread that keeps the newest reading, and the base class of its sensors."""

import os
import select
import threading
from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from math import inf, isnan, nan
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, Protocol, TypeVar

import numpy as np
from pydantic import Field, StrictBool

from palpate.robot_io.clock import Clock, SimulatedClock
from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.serial_force.stream import LineSplitter, ReadingStream
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError, error_text
from palpate.robot_io.examination import Finding, ok
from palpate.robot_io.extras import LazyModule
from palpate.robot_io.files.file_model import Capacity, FileModel, NotNegative
from palpate.robot_io.interfaces import Bus, ForceSensor
from palpate.robot_io.serial_port import close_exclusive, open_exclusively, write_at_once
from palpate.robot_io.types import Reading, Status

if TYPE_CHECKING:
    import serial
else:
    serial = LazyModule("serial")

_LOOK_S = 1e-3  # longest time between reads of the thread
_PROMPT_S = 2.5e-3  # time between two reads within which bytes count as just arrived
_DISCARD = 2  # readings discarded after a damaged one; multiplied if damage recurs soon
_DISCARD_MORE = 4  # more, but no more than
_DISCARD_MOST = 1000
_SOON = 100  # valid readings within which damage recurs soon
_JUMP_SHARE = 0.01  # of the capacity; a reading that jumps by more needs the next one to confirm it


class ForceSample(NamedTuple):
    """One reading with the sensor's own sign [N], and its actual or due arrival time, robot's clock [s]."""

    force_n: float
    arrived_at_s: float
    late_s: float = 0.0  # delay of its arrival after the due time


class SerialReader:
    """Keeps the newest valid reading of a port and drops older ones that were not fetched.

    If more time than usual passes between two reads of the port, the arrival of the bytes is unknown, and
    they get the time of the earlier read. So a reader that falls behind shows an old sample, never a fresh
    one.

    Many protocols have no checksum. After damaged data the next two readings are discarded, and more of them
    if damage recurs. A jump by more than 1 % of the capacity is accepted only with the next reading, if that
    stays there or continues in the same direction: a lost byte or a flipped bit shows once. With a checksum
    for each reading, none of this is needed.

    A reading that is late by the sensor's own time gets an earlier time, and a requested reading gets the
    time of its request; see `ReadingStream`.

    Args:
        file_descriptor: an open port that does not block.
        stream: parser of the bytes.
        clock: robot's clock.
        capacity_n: end of the sensor's range [N].

    Attributes:
        newest: the newest reading; None before the first.
        failure: why the port can no longer be read, or None.
    """

    def __init__(self, file_descriptor: int, stream: ReadingStream, clock: Clock, capacity_n: float) -> None:
        self._is_prompt = False  # whether the bytes have just arrived
        self._file_descriptor, self._stream, self._clock = file_descriptor, stream, clock
        self._poll = select.poll()
        self._poll.register(file_descriptor, select.POLLIN)
        self._looked_s = clock.now_s()
        self._to_discard, self._discard_next = 0, _DISCARD
        self._good = 0  # readings since the last damaged one
        self._jump_n = _JUMP_SHARE * capacity_n
        # Accepted reading; reading that waits for the next one; last accepted step.
        self._last_n = self._held_n = self._step_n = nan
        self._implausible = 0
        self._last_fault, self._fault_at_s = "", -inf
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.newest: ForceSample | None = None
        self.failure: str | None = None

    @property
    def rejected(self) -> int:
        """Number of damaged and implausible readings so far."""
        return self._stream.rejected + self._implausible

    def fault_text(self, since_s: float) -> str:
        """Return the error that the sensor reports, or has reported since a time; an empty string if none.

        Args:
            since_s: robot's clock [s].
        """
        return self._stream.fault_text or (self._last_fault if self._fault_at_s >= since_s else "")

    def start(self) -> None:
        """Read the port until `stop`: in a thread, or, on a simulated clock, whenever time has advanced.

        Simulated time does not advance during a read, so that runs are repeatable.
        """
        if isinstance(self._clock, SimulatedClock):
            self._clock.subscribe(lambda _: self.read_port())
            return
        self._thread = threading.Thread(target=self._run, name="force sensor", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop reading the port. Can be called repeatedly."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def read_port(self, wait_s: float = 0.0) -> None:
        """Process received bytes after waiting for them at most `wait_s` [s].

        Args:
            wait_s: longest wait [s].
        """
        if self.failure is not None or self._stop.is_set():
            return
        try:
            pieces = self._receive() if self._poll.poll(1e3 * wait_s) else []
        except EOFError:
            self.failure = "the port was unplugged"
            return
        except (OSError, ValueError) as error:
            self.failure = f"the port failed ({error})"
            return
        now_s, before_s = self._clock.now_s(), self._looked_s
        self._looked_s = now_s
        self._is_prompt = now_s - before_s <= _PROMPT_S
        arrived_s = (now_s if self._is_prompt else before_s) - self._stream.held_back_s
        for data in pieces:
            self._process_data(data, arrived_s)
        if self._stream.poll:
            question = self._stream.poll.to_send(now_s)
            try:
                if question:
                    os.write(self._file_descriptor, question)
            except OSError as error:
                self.failure = f"the port failed ({error})"

    def _receive(self) -> list[bytes]:
        """Return received bytes in the portions for the stream; raise `EOFError` if the port is gone."""
        data = os.read(self._file_descriptor, 65536)
        if not data:
            raise EOFError
        return [data]

    def _process_data(self, data: bytes, read_s: float) -> None:
        arrived_s: float | None = read_s
        stream, rejected = self._stream, self._stream.rejected
        samples = stream.feed(data)
        if stream.fault_text:
            self._last_fault, self._fault_at_s = stream.fault_text, self._clock.now_s()
        is_damaged = stream.rejected != rejected
        if stream.poll and (samples or is_damaged):
            asked_s = stream.poll.answered(read_s)
            arrived_s = asked_s if len(set(samples)) <= 1 else None  # several readings were not requested
        late_s = 0.0
        if stream.sensor_clock and samples and arrived_s is not None:
            dated_s = stream.sensor_clock.sampled_at_s(arrived_s, prompt=self._is_prompt)
            arrived_s, late_s = dated_s, arrived_s - dated_s
        for force_n in self._undamaged(samples, is_damaged=is_damaged):
            if arrived_s is not None and (stream.has_checksums or self._is_plausible(force_n)):
                self.newest = ForceSample(force_n, arrived_s, late_s)

    def _undamaged(self, samples: list[float], *, is_damaged: bool) -> list[float]:
        """Return the received readings, without those beside damaged ones or soon after them."""
        if self._stream.has_checksums:
            return samples
        if is_damaged:
            self._to_discard, self._good = self._discard_next, 0
            self._held_n = nan
            if self.newest:  # a greeting before the first reading is not damage
                self._discard_next = min(_DISCARD_MORE * self._discard_next, _DISCARD_MOST)
            return []
        self._good += len(samples)
        if self._good >= _SOON:
            self._discard_next = _DISCARD
        discarded, self._to_discard = self._to_discard, max(0, self._to_discard - len(samples))
        return samples[discarded:]

    def _is_plausible(self, force_n: float) -> bool:
        """Return whether a reading is near the last one, confirms a jump, or continues a confirmed one."""
        # The very first reading counts as a jump, because its line may be incomplete.
        last_n, held_n, jump_n = self._last_n, self._held_n, self._jump_n
        is_near = abs(force_n - last_n) <= jump_n
        before_n, step_before_n = (last_n, self._step_n) if isnan(held_n) else (held_n, held_n - last_n)
        step_n = force_n - before_n
        goes_on = step_n * step_before_n > 0.0 and abs(step_n) <= 2.0 * abs(step_before_n) + jump_n
        if is_near or abs(step_n) <= jump_n or (goes_on and abs(step_before_n) > jump_n):
            self._step_n = force_n - last_n if is_near else step_n
            self._implausible += is_near and not isnan(held_n)
            self._last_n, self._held_n = force_n, nan
            return True
        self._implausible += not isnan(held_n)
        self._held_n = force_n
        return False

    def _run(self) -> None:
        try:
            while not self._stop.is_set() and self.failure is None:
                self.read_port(_LOOK_S)
        except Exception as error:  # a thread must not end unnoticed
            self.failure = f"reading failed ({error_text(error)})"


Answer = TypeVar("Answer")

# Share of the age limit from which silence is reported, so that the cause is known at the limit.
_SILENT_SHARE = 0.5


class ForceLineSettings(FileModel):
    """Settings in the robot file, extended by each kind of line."""

    # Delay from sampling to arrival: filter, transmission, latency timer of the USB adapter [s].
    delay_s: Annotated[NotNegative, Field(le=1)] = 0.0


class BytePort(Protocol):
    """Interface of an open port; no call waits for long."""

    def fileno(self) -> int:
        """Return the file descriptor."""

    def read(self, size: int, /) -> bytes:
        """Return received bytes, at most `size` or one datagram."""

    def write(self, data: bytes, /) -> object:
        """Send bytes to the sensor."""


class ForceLine(Bus):
    """A line with one force sensor.

    Attributes:
        sample: newest reading as of the last poll; None before the first.
    """

    Settings: ClassVar[type[ForceLineSettings]]
    reader_type: ClassVar[type[SerialReader]] = SerialReader
    _settings: ForceLineSettings

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._settings = context.settings_as(self.Settings, settings)
        self._clock = context.clock
        self._silent_s = _SILENT_SHARE * context.robot_file.limits.force_age_s
        self._port: BytePort | None = None
        self._reader: SerialReader | None = None
        self._capacity_n = float("inf")
        self.sample: ForceSample | None = None

    @property
    @abstractmethod
    def label(self) -> str:
        """Name of the line in messages."""

    @abstractmethod
    def _close_port(self) -> None:
        """Close the port that is open."""

    def close(self) -> None:
        """Stop reading and close the port. Can be called repeatedly."""
        if self._reader is not None:
            self._reader.stop()
            self._reader = None
        if self._port is not None:
            self._close_port()
            self._port = None

    def write(self, data: bytes) -> None:
        """Send bytes to the sensor.

        Args:
            data: the bytes of a command or request.

        Raises:
            DeviceError: the line is not open, or the port failed.
        """
        try:
            self._opened().write(data)
        except OSError as error:
            raise DeviceError(f"{self.label}: cannot be written to ({error})") from error

    def ask(
        self, question: bytes, parse_reply: Callable[[bytes], Answer | None], timeout_s: float
    ) -> Answer | None:
        """Send `question`; return what `parse_reply` finds in the received bytes, or None if it times out.

        Must be called before `listen`.

        Args:
            question: bytes for the sensor.
            parse_reply: parses all received bytes into an answer, or None.
            timeout_s: longest wait [s].

        Raises:
            DeviceError: the port failed.
        """
        self.write(question)
        end_s = self._clock.now_s() + timeout_s
        while self._clock.now_s() < end_s:
            self._clock.sleep_until(self._clock.now_s() + _LOOK_S)
            try:
                data = self._opened().read(4096)
            except OSError as error:
                raise DeviceError(f"{self.label}: cannot be read ({error})") from error
            answer = parse_reply(data) if data else None
            if answer is not None:
                return answer
        return None

    def listen(self, stream: ReadingStream, capacity_n: float) -> None:
        """Parse all bytes as readings with `stream`; readings from `capacity_n` [N] on are saturated.

        Args:
            stream: parser of the bytes.
            capacity_n: end of the sensor's range [N].

        Raises:
            DeviceError: the port is not open.
        """
        self._capacity_n = capacity_n
        self._reader = self.reader_type(self._opened().fileno(), stream, self._clock, capacity_n)
        self._reader.start()

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`; never waits, and takes no sample of a sensor that has failed.

        Raises:
            DeviceError: the port failed, or the sensor says that it has.
            DeviceTimeoutError: the sensor is silent, or has sent data but no valid reading yet.
        """
        reader = self._reader
        if reader is None:
            return
        # An error of a single reading, between two polls, counts as well.
        now_s = self._clock.now_s()
        if problem := reader.failure or reader.fault_text(now_s - self._silent_s):
            raise DeviceError(f"{self.label}: {problem}")
        self.sample = reader.newest
        if self.sample is None:
            if reader.rejected:
                raise DeviceTimeoutError(
                    f"{self.label}: {reader.rejected} lines or telegrams arrived, but no reading "
                    "yet: check that driver, baud rate, pattern and unit match the sensor"
                )
            return
        age_s = now_s - self.sample.arrived_at_s
        if age_s > self._silent_s:
            late_s = self.sample.late_s
            late = f"; the last one came {late_s * 1e3:.1f} ms late" if late_s > self._silent_s else ""
            rejected = f"; {reader.rejected} were damaged so far" if reader.rejected else ""
            raise DeviceTimeoutError(f"{self.label}: no reading for {age_s * 1e3:.1f} ms{late}{rejected}")

    def flush(self, deadline_s: float) -> None:
        """See `Bus.flush`; a tick sends nothing to a sensor."""

    def reading(self, *, reversed_sign: bool) -> Reading:
        """Return the newest sample, compression positive [N], shape (1,); NaN and stale before the first.

        Args:
            reversed_sign: whether the sensor counts tension as positive.
        """
        if self.sample is None:
            return Reading(np.full(1, np.nan), -np.inf, Status.STALE)
        force_n, arrived_at_s, _ = self.sample
        status = Status.SATURATED if abs(force_n) >= self._capacity_n else Status.OK
        value = np.array([-force_n if reversed_sign else force_n])
        return Reading(value, arrived_at_s - self._settings.delay_s, status)

    def _opened(self) -> BytePort:
        if self._port is None:
            raise DeviceError(f"{self.label}: not open")
        return self._port


class SerialLineSettings(ForceLineSettings):
    """Settings in the robot file."""

    # Better /dev/serial/by-id/... than /dev/ttyUSB0.
    port: Annotated[str, Field(min_length=1, max_length=300)]
    baud_rate: Annotated[int, Field(gt=0, le=12_000_000, strict=True)]


class SerialLine(ForceLine):
    """A serial port, opened exclusively."""

    name = "serial_line"
    Settings = SerialLineSettings
    _settings: SerialLineSettings
    _port: "serial.Serial | None"

    @property
    def label(self) -> str:
        return f"serial port {self._settings.port}"

    @property
    def baud_rate(self) -> int:
        """Baud rate of the robot file [bit/s]."""
        return self._settings.baud_rate

    def configure(self) -> None:
        """Open the port; raise `DeviceError` if it is not there, not permitted, or in use."""
        self._port = open_exclusively(self._settings.port, self._settings.baud_rate)
        self._port.reset_input_buffer()

    def write(self, data: bytes) -> None:
        """See `ForceLine.write`; a blocked output is a failure, too."""
        try:
            write_at_once(self._opened().fileno(), data)
        except OSError as error:  # pyserial's own errors have no text of the system
            raise DeviceError(f"{self.label}: cannot be written to ({error.strerror or error})") from error

    def _close_port(self) -> None:
        if self._port is not None:
            close_exclusive(self._port)


class SerialForceSettings(FileModel):
    """Settings in the robot file, extended by each sensor."""

    reversed: StrictBool = False  # whether the sensor counts tension as positive


class AxisForceSettings(SerialForceSettings):
    """One axis of a sensor of forces and torques."""

    axis: Literal["x", "y", "z"]  # axis of the sensor along which the tool pushes
    capacity_n: Capacity  # of this axis [N]


class SerialForceSensor(ForceSensor):
    """A force sensor on its own line; also `Examinable` if it can identify itself."""

    Settings: ClassVar[type[SerialForceSettings]]
    line_type: ClassVar[type[ForceLine]] = SerialLine
    end_of_stream: ClassVar[bytes] = b""  # command that ends its stream, if it needs one

    _settings: SerialForceSettings

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._settings = context.settings_as(self.Settings, settings)
        self._bus = context.bus_as(self.line_type)
        self._identified = ""  # identity of the sensor

    def _ask_line(
        self, question: bytes, take: Callable[[bytes], Answer | None], timeout_s: float
    ) -> Answer | None:
        """Return the result of `take` for the first line that it accepts; None if none arrives in time."""
        lines = LineSplitter()

        def first(data: bytes) -> Answer | None:
            return next((answer for line in lines.feed(data) if (answer := take(line)) is not None), None)

        return self._bus.ask(question, first, timeout_s)

    def _error(self, problem: str) -> DeviceError:
        return DeviceError(f"{self._bus.label}: {problem}")

    def examine(self) -> tuple[Finding, ...]:
        """Return the identity that the sensor reported in `configure`."""
        return (ok("force sensor", self._identified),) if self._identified else ()

    def close(self) -> None:
        """End the stream."""
        if self.end_of_stream:
            with suppress(DeviceError):  # the sensor is disconnected, so there is nothing to end
                self._bus.write(self.end_of_stream)

    def read_force(self) -> Reading:
        return self._bus.reading(reversed_sign=self._settings.reversed)
