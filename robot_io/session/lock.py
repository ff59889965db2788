"""The lock on a session file while a program writes it; it is gone with that program, however it ends."""

import fcntl
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from palpate.robot_io.errors import SessionError

_WAIT_S, _POLL_S = 1.0, 0.01  # for a program that only looks whether there is a lock


def lock(file: BinaryIO) -> None:
    """Hold the file until it is closed. SessionError: another program holds it.

    Args:
        file: open for writing.
    """
    give_up_s = time.monotonic() + _WAIT_S
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > give_up_s:
                raise SessionError("another program holds it") from None
            time.sleep(_POLL_S)
        except OSError:  # a file system without locks; that the file was made anew keeps others away there
            return
        else:
            return


def is_locked(path: Path) -> bool:
    """Whether a program is writing a file at this moment, as far as the file system can tell.

    Args:
        path: of a file that is there.
    """
    with suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe is not waited for
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(descriptor)
    return False
