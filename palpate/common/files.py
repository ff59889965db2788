"""Check files that the user names before any work is done, and find the folders of results.

No file is replaced without `--force`, and an input file never. Files derived from a session lie in a folder
of the same name beside it, or in the working directory. Such folders, and folders of revisions, belong to
palpate, which overwrites their contents.
"""

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from palpate.common.console import typed
from palpate.common.failures import make_folder
from palpate.estimation.data.file_columns import is_session
from palpate.robot_io.errors import InputError, SessionError
from palpate.robot_io.files.whole_file import as_utf8
from palpate.robot_io.files.whole_file import whole_file as written_whole
from palpate.robot_io.session import Session

SESSION = ".mcap"


def existing_file(path: Path, what: str) -> Path:
    """Return the path if it is a readable regular file, not a device or a pipe.

    Args:
        path: as the user gave it.
        what: what it should be, such as "session".

    Raises:
        InputError: the path does not exist, is no file, or is not readable.
    """
    if path.is_dir():
        raise InputError(f"{what} {path}: is a directory, not a file")
    if not path.exists():
        raise InputError(f"{what} {path}: no such file")
    if not path.is_file():
        raise InputError(f"{what} {path}: is a device or a pipe, not a file")
    if not os.access(path, os.R_OK):
        raise InputError(f"{what} {path}: permission denied")
    return path


def existing_data(path: Path) -> Path:
    """Return the path if it is a folder or a readable file; `InputError` if not.

    Args:
        path: as the user gave it.
    """
    return path if path.is_dir() else existing_file(path, "session or data file")


def open_session(path: Path) -> Session:
    """Read a session file; `InputError` if it does not exist or is no session.

    Args:
        path: as the user gave it.
    """
    try:
        return Session.open(existing_file(path, "session"))
    except SessionError as error:
        if path.suffix == ".mcap":
            raise
        data = typed(path)
        raise InputError(
            f"{error}. If it is a table of measurements, palpate import {data} makes a session of it; "
            f"palpate compare {data} and other commands read the table as it is"
        ) from error


def output_file(path: Path, *, force: bool | None = None, keep: Iterable[Path] = ()) -> Path:
    """Return the path if a file can be written there, and create its folder.

    A folder that is empty when the command ends is removed; see `remove_empty_folders`.

    Args:
        path: as the user gave it.
        force: whether a file that already exists may be replaced; None where that is not offered.
        keep: what is read, which is never replaced.

    Raises:
        InputError: something is in the way and may not be replaced, or the folder cannot be written to.
    """
    if path.is_dir():
        raise InputError(f"output {path}: is a directory")
    if path.exists() or path.is_symlink():
        if path.exists() and any(read.exists() and path.samefile(read) for read in keep):
            raise InputError(f"output {path}: is the input; choose another name")
        if not force:
            remedy = "choose another name" + (", or add --force to replace it" if force is False else "")
            raise InputError(f"output {path}: exists already; {remedy}")
        if not path.is_file():
            raise InputError(f"output {path}: is not a regular file, and is not replaced")
    output_folder(path.parent)
    return path


def output_session(path: Path, keep: Iterable[Path] = ()) -> Path:
    """Check the path of a new session; see `output_file`. InputError: its ending is not a session's.

    Args:
        path: as the user gave it.
        keep: what is read, which is never replaced.
    """
    if path.suffix != SESSION and not path.is_dir():
        raise InputError(
            f"output {path}: a session's name ends in {SESSION}, such as {path.with_suffix(SESSION)}; "
            "palpate export writes tables"
        )
    return output_file(path, keep=keep)


def output_folder(folder: Path) -> Path:
    """Return the folder, made if needed, if files can be written in it.

    Args:
        folder: as the user gave it.

    Raises:
        InputError: it cannot be made or written to.
    """
    try:
        make_folder(folder)
        with tempfile.TemporaryFile(dir=folder):  # permissions alone are not enough, for example in /proc
            pass
    except FileExistsError as error:
        raise InputError(f"output folder {folder}: is a file, not a folder; choose another name") from error
    except OSError as error:
        raise InputError(f"output folder {folder}: cannot be written to ({error.strerror})") from error
    return folder


def spare_files(folder: Path, names: Iterable[str], *, force: bool, keep: Iterable[Path] = ()) -> None:
    """Refuse to fill a folder where that would replace protected files.

    Args:
        folder: it need not exist yet.
        names: of the files that may be written; patterns as of `Path.glob`.
        force: whether files of these names may be replaced.
        keep: what is read, which is never replaced.

    Raises:
        InputError: something is in the way.
    """
    kept = tuple(keep)
    for taken in (path for name in names for path in folder.glob(name)):
        output_file(taken, force=force, keep=kept)


def different_files(*paths: Path | None) -> None:
    """Refuse outputs that would replace each other; `InputError` if two of them are one file."""
    named = [path for path in paths if path is not None]
    places = [os.path.realpath(path) for path in named]  # unlike Path.resolve, it accepts circular links
    for number, path in enumerate(named):
        if places[number] in places[:number]:
            raise InputError(f"output {path}: is given twice; give each output its own name")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name to write to; on success the file replaces the one of the final name.

    Args:
        path: the file; it appears whole or not at all.

    Raises:
        InputError: it cannot be written.
    """
    try:
        with written_whole(path) as unfinished:
            yield unfinished
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


@contextmanager
def whole_set(texts: Mapping[Path, str]) -> Iterator[None]:
    """Write several text files after the body of the `with`, or none if it fails.

    Args:
        texts: by the file's path.

    Raises:
        InputError: one of them cannot be written.
    """
    with ExitStack() as files:
        for path, text in texts.items():
            files.enter_context(whole_file(path)).write_text(as_utf8(text), encoding="utf-8")
        yield


def write_text(path: Path, text: str) -> None:
    """Write a file of text, whole or not at all; `InputError` if it cannot be written.

    Args:
        path: of the file.
        text: its content.
    """
    with whole_set({path: text}):
        pass


def derived_folder(path: Path) -> Path:
    """Return the usual folder of results; it need not exist yet.

    Args:
        path: a session, which has a folder beside it; a folder of sessions, which has one in it; or a data
            file, whose own folder may be anybody's: what is derived from it goes into the current one.
    """
    if path.is_dir():
        return path / "study"
    return path.with_suffix("") if is_session(path) else Path(f"{path.name.split('.')[0]}-palpate")


def folder_to_fill(path: Path, out: Path | None, names: Iterable[str], *, force: bool) -> Path:
    """Return the folder of results if these files can be put there; it need not exist yet.

    Args:
        path: session or data file.
        out: the folder that the user wants instead of the usual one.
        names: of the files that may be written; patterns as of `Path.glob`.
        force: whether files of these names may be replaced in a folder that the user named.

    Raises:
        InputError: a file is there that may not be replaced.
    """
    from palpate.estimation.study import Revisions  # noqa: PLC0415, takes half a second

    folder, own = out or derived_folder(path), out is None or Revisions(out).is_there
    spare_files(folder, names, force=force or own, keep=[path])
    return folder


def folder_to_read(path: Path, folder: Path | None) -> Path:
    """Return the folder in which revisions are kept; it may hold none yet.

    Args:
        path: session or data file.
        folder: that the user named; None for the usual one.

    Raises:
        InputError: the folder that the user names does not exist.
    """
    if folder is not None and not folder.is_dir():
        raise InputError(f"--folder {folder}: no such folder")
    return folder or derived_folder(path)
