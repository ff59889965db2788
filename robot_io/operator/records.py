"""Reads a device file of records of one size (terminal, joystick, mouse) without ever waiting."""

import os
from pathlib import Path

from robot_io.errors import DeviceError

_MOST_BYTES = 65_536  # in one reading


class RecordFile:
    """An open device file.

    Args:
        path: such as /dev/input/js0.
        size: bytes of a record.

    Raises:
        DeviceError: it cannot be opened.
    """

    def __init__(self, path: str | Path, size: int) -> None:
        self.path, self._size = path, size
        self._rest = b""
        try:
            self.file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError as error:
            raise DeviceError(f"{path}: cannot be opened ({error.strerror})") from error

    def read(self) -> list[bytes]:
        """All records that have come since the last call. DeviceError: the device is gone."""
        try:
            come = os.read(self.file, _MOST_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            raise DeviceError(f"{self.path}: the device is gone ({error.strerror})") from error
        if not come:
            raise DeviceError(f"{self.path}: the device is gone (end of file)")
        come = self._rest + come
        whole = len(come) - len(come) % self._size
        self._rest = come[whole:]
        return [come[start : start + self._size] for start in range(0, whole, self._size)]

    def close(self) -> None:
        """Close it."""
        os.close(self.file)
