"""Keeps a serial CAN adapter for one program: python-can opens its port without asking who else has it."""

import fcntl
import os
import stat

from robot_io.errors import DeviceError


class PortLock:
    """An exclusive lock on a serial port, as pyserial and others ask for it; held until `release`.

    Args:
        channel: what python-can is given, such as /dev/ttyACM0@115200. What is no port needs no lock.

    Raises:
        DeviceError: another program, or another part of this one, has the port.
    """

    def __init__(self, channel: str | int) -> None:
        self._fd = -1
        path = str(channel).partition("@")[0]
        try:
            if not stat.S_ISCHR(os.stat(path).st_mode):
                return
            self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:
            return  # opening the adapter will say what is wrong
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self.release()
            raise DeviceError(f"{path}: in use by another program") from error

    def release(self) -> None:
        """Let others have it. Can be called again."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)
