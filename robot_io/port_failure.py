"""Why a serial port cannot be used, in words."""

import errno
import os


def reason_of(error: Exception) -> str:
    """Why a port cannot be used, in the words of the system and without its path."""
    number = getattr(error, "errno", None)
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program has it"
    return os.strerror(number) if number else " ".join(str(error).split())
