"""Device files of records of one size (terminal, joystick, mouse), read without waiting; hands they move."""

import os
from pathlib import Path

import numpy as np

from robot_io.errors import DeviceError
from robot_io.files.file_model import Number
from robot_io.operator.modelled_hand import HandSettings, ModelledHand

_MOST_BYTES = 65_536  # in one reading


class RecordFile:
    """An open device file, such as /dev/input/js0, of records of `size` bytes.

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


class RecordSettings(HandSettings):
    """Where the hand begins."""

    start_world_m: tuple[Number, Number, Number] = (0.4, 0.0, 0.15)


class RecordHand(ModelledHand):
    """A modelled hand whose goal is moved by what a device file says."""

    settings: RecordSettings
    _file: RecordFile | None = None

    def _open_file(self, path: str, size: int) -> RecordFile:
        self._goal_m, self._select = np.array(self.settings.start_world_m), False
        self._file = RecordFile(path, size)
        return self._file

    def _records(self) -> list[bytes]:
        return self._file.read() if self._file else []

    def _release(self) -> None:
        super()._release()
        if self._file is not None:
            self._file.close()
            self._file = None
