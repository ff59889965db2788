"""Serial port with one owner, which is opened exclusively, never blocks, and is closed after a failure."""

import errno
import fcntl
import os
import select
import termios
from contextlib import suppress
from typing import TYPE_CHECKING

from palpate.robot_io.clock import Clock, SimulatedClock
from palpate.robot_io.errors import DeviceError, one_line
from palpate.robot_io.extras import LazyModule

if TYPE_CHECKING:
    import serial
else:
    serial = LazyModule("serial")


def _reason_of(error: Exception) -> str:
    """Write why a port cannot be used, without its path."""
    number = getattr(error, "errno", None)
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program has it"
    return os.strerror(number) if number else one_line(error)


def open_exclusively(path: str, baud_rate: int) -> "serial.Serial":
    """Open a port with 8 data bits, no parity, 1 stop bit; reading never waits.

    Args:
        path: path of the port.
        baud_rate: [bit/s].

    Raises:
        DeviceError: there is no such port, no permission, or another program has it.
    """
    try:
        port = serial.Serial(path, baud_rate, timeout=0, exclusive=True)
    except (OSError, ValueError) as error:  # SerialException is an OSError
        raise DeviceError(f"{path}: cannot be opened ({_reason_of(error)})") from error
    with suppress(OSError):  # also against programs that do not ask for a lock
        fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
    with suppress(OSError, ValueError, AttributeError):  # USB adapters otherwise hold bytes back for 16 ms
        port.set_low_latency_mode(True)
    return port


def write_at_once(file_descriptor: int, data: bytes) -> None:
    """Write all bytes to a port that never blocks, without waiting.

    pyserial's own `write` with a time limit also fails if all bytes were sent, but the process was paused.

    Args:
        file_descriptor: an open port that does not block.
        data: bytes to send.

    Raises:
        BlockingIOError: the port did not take all bytes.
        OSError: the port is gone.
    """
    try:
        sent = os.write(file_descriptor, data)
    except BlockingIOError:
        sent = 0
    if sent != len(data):
        raise BlockingIOError(errno.EAGAIN, f"took {sent} of {len(data)} bytes; its output is blocked")


def close_exclusive(port: "serial.Serial") -> None:
    """Close a port and let others use it.

    Args:
        port: opened by `open_exclusively`.
    """
    with suppress(OSError):
        fcntl.ioctl(port.fileno(), termios.TIOCNXCL)
    with suppress(OSError):
        port.close()


_LOOK_S = 50e-6  # period of polling on simulated time
_CHUNK = 4096


class SerialPort:
    """A serial port, 8 data bits, no parity, 1 stop bit: each byte takes ten bits of the baud rate.

    After a failure it is closed, and `failure` says why; it can be opened again.
    """

    def __init__(self, path: str, baud_rate: int, clock: Clock) -> None:
        self.path = path
        self.baud_rate = baud_rate
        self.failure: str | None = None
        self._clock = clock
        self._serial: serial.Serial | None = None
        self._fd, self._poll = -1, select.poll()

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._fd >= 0

    def duration_s(self, byte_count: int) -> float:
        """Compute how long bytes take on the wire [s].

        Args:
            byte_count: number of bytes.
        """
        return byte_count * 10.0 / self.baud_rate

    def open(self) -> None:
        """Open the port for this program alone, and forget failures; raise `DeviceError` if that fails."""
        self.close()
        self._serial = open_exclusively(self.path, self.baud_rate)
        self._fd, self._poll = self._serial.fileno(), select.poll()
        self._poll.register(self._fd, select.POLLIN)
        self.failure = None

    def close(self) -> None:
        """Close the port; can be called repeatedly."""
        port, self._serial, self._fd = self._serial, None, -1
        if port is not None:
            close_exclusive(port)

    def write(self, data: bytes) -> None:
        """Send bytes; raise `DeviceError` if the port is closed or gone, or its output is blocked.

        Args:
            data: data to send.
        """
        try:
            write_at_once(self._fd if self._fd >= 0 else self._usable(), data)
        except BlockingIOError as error:
            raise DeviceError(f"{self.path}: {error.strerror}") from error
        except OSError as error:
            raise self._failed(error) from error

    def read(self) -> bytes:
        """Return received bytes without waiting; raise `DeviceError` if the port is closed or gone."""
        try:
            return os.read(self._fd if self._fd >= 0 else self._usable(), _CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._failed(error) from error

    def wait(self, deadline_s: float) -> bytes:
        """Wait for bytes and return them, none at the deadline; raise `DeviceError` if closed or gone.

        Args:
            deadline_s: end of the wait, robot's clock [s].
        """
        if isinstance(self._clock, SimulatedClock):
            data = self.read()
            while not data and self._clock.now_s() < deadline_s:
                self._clock.sleep_until(min(deadline_s, self._clock.now_s() + _LOOK_S))
                data = self.read_all()
            if data:
                return data
        remaining_s = max(0.0, deadline_s - self._clock.now_s())
        try:
            readable, _, _ = select.select([self._usable()], [], [], remaining_s)
        except (OSError, ValueError) as error:
            raise self._failed(error) from error
        data = self.read() if readable else b""
        if readable and not data:  # a port that is gone is always ready, and has nothing
            raise self._failed(OSError("hung up"))
        return data

    def read_all(self) -> bytes:
        """Return all received bytes without waiting; raise `DeviceError` if the port is closed or gone."""
        if not self._poll.poll(0) and self._fd >= 0:  # in most ticks; faster than a read that fails
            return b""
        received = b""
        while data := self.read():
            received += data
        return received

    def _usable(self) -> int:
        if self._fd < 0:
            raise DeviceError(f"{self.path}: {self.failure or 'the port is not open'}")
        return self._fd

    def _failed(self, error: Exception) -> DeviceError:
        self.close()
        self.failure = f"the port has failed ({_reason_of(error)}); unplugged?"
        return DeviceError(f"{self.path}: {self.failure}")
