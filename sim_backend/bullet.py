"""The one place that imports PyBullet, whose extension module greets on stderr at import.

A program whose bad input ends in one clear line cannot have a banner above it, and the banner comes from C,
so it is caught at the file descriptor.
"""

import os
import sys


def _import_quietly() -> None:
    sys.stderr.flush()
    kept = os.dup(2)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        import pybullet  # noqa: F401, PLC0415 - imported here for its banner alone
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)


_import_quietly()

import pybullet as bullet  # noqa: E402

__all__ = ["bullet"]
