"""Runs code of the user's own: effects and drivers."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

from robot_io.errors import InputError, describe_error

LIMIT_S = 30.0  # for loading, and for trying each method once; a search calls them thousands of times


class _TooLongError(BaseException):
    """Raised within the code; what catches every `Exception` lets it pass."""


@contextmanager
def foreign_code(where: str, limit_s: float | None = None, own_file: str = "") -> Iterator[None]:
    """Within, whatever is raised is one clear line, also what would end the program; but not Ctrl-C.

    What the code prints goes to stderr: stdout is for results, which a program may read.

    Args:
        where: what is run, for the error.
        limit_s: time after which it is given up, in the main thread alone [s]; None for no limit.
        own_file: the user's file, whose line the error names.

    Raises:
        InputError: the code failed, or took too long.
    """
    try:
        with redirect_stdout(sys.stderr), _limited(limit_s):
            yield
    except _TooLongError as error:
        raise InputError(f"{where}: has not come to an end in {error} s; does it wait, or loop?") from None
    except (KeyboardInterrupt, InputError):
        raise
    except BaseException as error:
        raise InputError(f"{where}: {describe_error(error, own_file)}") from error


@contextmanager
def _limited(limit_s: float | None) -> Iterator[None]:
    if limit_s is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: object) -> None:
        raise _TooLongError(f"{limit_s:g}")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
