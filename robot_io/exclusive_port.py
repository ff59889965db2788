"""Opens a serial port for one owner, so that what comes is handed over at once."""

import fcntl
import termios
from contextlib import suppress

import serial

from robot_io.errors import DeviceError
from robot_io.port_failure import reason_of


def open_exclusively(path: str, baud_rate: int, write_timeout_s: float | None = None) -> serial.Serial:
    """Open a port of 8 data bits, no parity, 1 stop bit; reading never waits.

    Args:
        path: device file.
        baud_rate: bits per second.
        write_timeout_s: how long a write may take [s]; None leaves that to the system.

    Raises:
        DeviceError: there is no such port, no permission, or another program has it.
    """
    try:
        port = serial.Serial(path, baud_rate, timeout=0, write_timeout=write_timeout_s, exclusive=True)
    except (OSError, ValueError) as error:  # SerialException is an OSError
        raise DeviceError(f"{path}: cannot be opened ({reason_of(error)})") from error
    with suppress(OSError):  # also against programs that do not ask for a lock
        fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
    with suppress(OSError, ValueError, AttributeError):  # USB adapters otherwise hold bytes back for 16 ms
        port.set_low_latency_mode(True)
    return port


def close_exclusive(port: serial.Serial) -> None:
    """Let others have it."""
    with suppress(OSError):
        fcntl.ioctl(port.fileno(), termios.TIOCNXCL)
    with suppress(OSError):
        port.close()
