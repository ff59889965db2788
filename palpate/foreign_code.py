"""Runs code of the user's own: effects and drivers."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

from robot_io.errors import InputError, in_words


@contextmanager
def foreign_code(where: str) -> Iterator[None]:
    """Within, whatever is raised is one clear line, also what would end the program; but not Ctrl-C.

    What the code prints goes to stderr: stdout is for results, which a program may read.

    Args:
        where: what is run, for the error.

    Raises:
        InputError: the code failed.
    """
    try:
        with redirect_stdout(sys.stderr):
            yield
    except (KeyboardInterrupt, InputError):
        raise
    except BaseException as error:
        raise InputError(f"{where}: {in_words(error)}") from error
