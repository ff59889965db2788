"""Files that the user names: checked before any work is done, so that nothing is half done."""

import os
from pathlib import Path

from robot_io.errors import InputError
from robot_io.session import Session


def existing_file(path: Path, what: str) -> Path:
    """The path, if a readable file is there.

    Args:
        path: as the user gave it.
        what: what it should be, such as "session".

    Raises:
        InputError: nothing is there, or no file, or it may not be read.
    """
    if path.is_dir():
        raise InputError(f"{what} {path}: is a directory, not a file")
    if not path.exists():
        raise InputError(f"{what} {path}: no such file")
    if not os.access(path, os.R_OK):
        raise InputError(f"{what} {path}: no right to read it")
    return path


def open_session(path: Path) -> Session:
    """Read a session file.

    Raises:
        InputError: it is not there or is no session.
    """
    return Session.open(existing_file(path, "session"))


def output_file(path: Path, *, force: bool | None = None, keep: Path | None = None) -> Path:
    """The path, if a file can be written there; its folder is made.

    Args:
        path: as the user gave it.
        force: whether a file that is there already may be replaced; None where that is not offered.
        keep: what is read, which is never replaced.

    Raises:
        InputError: something is in the way and may not be replaced, or the folder cannot be written to.
    """
    if path.is_dir():
        raise InputError(f"output {path}: is a directory")
    if keep is not None and path.exists() and path.samefile(keep):
        raise InputError(f"output {path}: is what is read; choose another name")
    if path.exists() and not force:
        remedy = "choose another name" + (", or add --force to replace it" if force is False else "")
        raise InputError(f"output {path}: exists already; {remedy}")
    output_folder(path.parent)
    return path


def output_folder(folder: Path) -> Path:
    """The folder, made if needed, if files can be written in it.

    Raises:
        InputError: it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"output folder {folder}: {error.strerror}") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"output folder {folder}: no right to write there")
    return folder
