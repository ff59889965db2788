"""The one place that imports PyBullet, and keeps what its C code prints out of the user's output.

It greets on stderr when it is imported and explains a bad URDF on stdout, past Python's own streams. A
program whose bad input ends in one clear line, and whose JSON others read, must catch both.
"""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

STDOUT, STDERR = 1, 2


@contextmanager
def captured(descriptor: int, lines: list[str]) -> Iterator[None]:
    """Append to `lines` what is written to the file descriptor, in place of writing it."""
    _flush()
    kept = os.dup(descriptor)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), descriptor)
        try:
            yield
        finally:
            _flush()
            os.dup2(kept, descriptor)
            os.close(kept)
            file.seek(0)
            lines += file.read().decode("utf-8", "replace").splitlines()


def _flush() -> None:
    """Write out what Python and C still hold back, so that it goes where it was meant to go."""
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)


with captured(STDERR, []):
    import pybullet as bullet

__all__ = ["STDERR", "STDOUT", "bullet", "captured"]
