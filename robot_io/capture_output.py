"""Capture output that C code prints past Python's original streams.

Errors are printed as one line, and other programs read the JSON output, so nothing else may be printed.
"""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

STDOUT, STDERR = 1, 2


@contextmanager
def capture_output(lines: list[str], *descriptors: int) -> Iterator[None]:
    """Append text written to file descriptors to `lines` instead of writing it.

    Args:
        lines: receives the captured lines.
        descriptors: file descriptors, such as `STDOUT` and `STDERR`.
    """
    _flush()
    originals = [(descriptor, os.dup(descriptor)) for descriptor in descriptors]
    in_memory = hasattr(os, "memfd_create")  # created late: reading a file must open none for writing
    file: BinaryIO
    with os.fdopen(os.memfd_create("captured"), "w+b") if in_memory else tempfile.TemporaryFile() as file:
        for descriptor in descriptors:
            os.dup2(file.fileno(), descriptor)
        try:
            yield
        finally:
            _flush()
            for descriptor, original in originals:
                os.dup2(original, descriptor)
                os.close(original)
            file.seek(0)
            lines += file.read().decode("utf-8", "replace").splitlines()


def _flush() -> None:
    """Flush the buffers of Python and C, so that earlier output reaches its destination."""
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)
