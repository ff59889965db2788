"""Checks before the rest of palpate is imported; they use the standard library only, to run anywhere."""

import sys
from pathlib import Path

OLDEST = (3, 11)


def python_problem(version: tuple[int, int]) -> str | None:
    """Describe a problem with the interpreter; None if there is none.

    Args:
        version: major and minor, as in `sys.version_info[:2]`.
    """
    if version >= OLDEST:
        return None
    return (
        f"palpate needs CPython 3.11 or newer, but this is {version[0]}.{version[1]}; install a newer "
        "version, then run: make PYTHON=python3.11 env"
    )


def folder_problem() -> str | None:
    """Report that the current folder was deleted; None if it exists."""
    try:
        Path.cwd()
    except OSError as error:
        return f"the current folder cannot be used ({error.strerror}): change to another one"
    return None


def library_remedy(error: ImportError) -> str | None:
    """Return the remedy if a package cannot load a system library; None for other failures.

    Pinocchio's wheel takes OpenMP from the system, which small images of Debian and Ubuntu do not have.

    Args:
        error: the import's exception.
    """
    return "on Debian and Ubuntu: apt install libgomp1" if ".so" in str(error) else None


def first_problem() -> str | None:
    """Return the first problem that keeps palpate from starting, with its remedy, or None."""
    return python_problem((sys.version_info[0], sys.version_info[1])) or folder_problem()
