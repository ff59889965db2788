"""Check files that the user names before any work is done, and find the folders of results.

No file is replaced without `--force`; an input file is never replaced. Files derived from a session lie in a
folder of the same name beside it, or in the working directory. Such folders, and folders of revisions, belong
to palpate, which overwrites their contents.
"""

import os
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from palpate.common.console import shell_path
from palpate.common.failures import make_folder
from palpate.estimation.data.file_columns import is_session
from palpate.robot_io.errors import InputError, SessionError
from palpate.robot_io.files.atomic_write import atomic_write as written_whole
from palpate.robot_io.files.atomic_write import replace_undecodable
from palpate.robot_io.session import Session

SESSION = ".mcap"


def existing_file(path: Path, what: str) -> Path:
    """Return the path if it is a readable regular file, not a device or a pipe.

    Args:
        path: path from the user.
        what: noun for the error message, such as "session".

    Raises:
        InputError: the path does not exist, is not a file, or is not readable.
    """
    if path.is_dir():
        # Of any other kind, the first file in the folder may be the wrong one.
        ending = {"session": SESSION, "URDF": ".urdf"}.get(what)
        files = sorted(file for file in path.glob(f"[!.]*{ending}") if file.is_file()) if ending else []
        remedy = f"; name a file in it, such as {files[0]}" if files else ""
        raise InputError(f"{what} {path}: is a directory, not a file{remedy}")
    if not path.exists():
        raise InputError(f"{what} {path}: no such file")
    if not path.is_file():
        raise InputError(f"{what} {path}: is a device or a pipe, not a file")
    if not os.access(path, os.R_OK):
        raise InputError(f"{what} {path}: permission denied")
    return path


def existing_data(path: Path) -> Path:
    """Return the path if it is a folder or a readable file; raise `InputError` otherwise.

    Args:
        path: path from the user.
    """
    return path if path.is_dir() else existing_file(path, "session or data file")


def open_session(path: Path) -> Session:
    """Read a session file; raise `InputError` if it does not exist or is not a session.

    Args:
        path: path from the user.
    """
    try:
        return Session.open(existing_file(path, "session"))
    except SessionError as error:
        if path.suffix == ".mcap":
            raise
        data = shell_path(path)
        raise InputError(
            f"{error}. If the file is a table of measurements, palpate import {data} converts it to a "
            f"session; palpate compare {data} and other commands also read it directly"
        ) from error


def output_file(
    path: Path, *, force: bool | None = None, keep: Iterable[Path] = (), endings: Collection[str] = ()
) -> Path:
    """Return the path if a file can be written there, and create its folder.

    A folder that is empty when the command ends is removed; see `remove_empty_folders`.

    Args:
        path: path from the user.
        force: whether an existing file may be replaced; None if the command has no such option.
        keep: input files, which are never replaced.
        endings: endings that the name may have, such as ".html"; empty for any. A name without an ending is
            accepted.

    Raises:
        InputError: the name has another ending, a file exists and may not be replaced, or the folder is not
            writable.
    """
    if path.is_dir():
        raise InputError(f"output {path}: is a directory")
    if path.exists() or path.is_symlink():
        if path.exists() and any(read.exists() and path.samefile(read) for read in keep):
            raise InputError(f"output {path}: is the input; choose another name")
        if not force:
            remedy = "choose another name" + (", or add --force to replace it" if force is False else "")
            raise InputError(f"output {path}: already exists; {remedy}")
        if not path.is_file():
            raise InputError(f"output {path}: is not a regular file, and is not replaced")
    if endings and path.suffix and path.suffix.lower() not in endings:
        raise InputError(f"output {path}: its name must end in {' or '.join(endings)}")
    output_folder(path.parent)
    return path


def output_session(path: Path, keep: Iterable[Path] = ()) -> Path:
    """Check the path of a new session as `output_file` does; raise `InputError` for a wrong file extension.

    Args:
        path: path from the user.
        keep: input files, which are never replaced.
    """
    if path.suffix != SESSION and not path.is_dir():
        raise InputError(
            f"output {path}: a session's name ends in {SESSION}, such as {path.with_suffix(SESSION)}; "
            "palpate export writes tables"
        )
    return output_file(path, keep=keep)


def output_folder(folder: Path) -> Path:
    """Return the folder if it is writable; create it if needed.

    Args:
        folder: path from the user.

    Raises:
        InputError: the folder cannot be created or written to.
    """
    try:
        make_folder(folder)
        with tempfile.TemporaryFile(dir=folder):  # permissions do not suffice, for example in /proc
            pass
    except FileExistsError as error:
        raise InputError(f"output folder {folder}: is a file, not a folder; choose another name") from error
    except OSError as error:
        raise InputError(f"output folder {folder}: cannot be written to ({error.strerror})") from error
    return folder


def spare_files(folder: Path, names: Iterable[str], *, force: bool, keep: Iterable[Path] = ()) -> None:
    """Raise an error if writing to a folder would replace protected files.

    Args:
        folder: folder, which may not exist yet.
        names: names of the files that may be written, or patterns for `Path.glob`.
        force: whether files with these names may be replaced.
        keep: input files, which are never replaced.

    Raises:
        InputError: a file exists and may not be replaced.
    """
    kept = tuple(keep)
    for taken in (path for name in names for path in folder.glob(name)):
        output_file(taken, force=force, keep=kept)


def different_files(*paths: Path | None) -> None:
    """Raise `InputError` if two outputs are the same file."""
    named = [path for path in paths if path is not None]
    # Unlike Path.resolve, realpath accepts circular links.
    places = [os.path.realpath(path) for path in named]
    for number, path in enumerate(named):
        if places[number] in places[:number]:
            raise InputError(f"output {path}: is given twice; give each output its own name")


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; on success, rename the file to its final name.

    Args:
        path: final path; the file is written completely or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    try:
        with written_whole(path) as unfinished:
            yield unfinished
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


@contextmanager
def atomic_write_all(texts: Mapping[Path, str]) -> Iterator[None]:
    """Write several text files after the body of the `with`, or none if it fails.

    Args:
        texts: text by path; existing files are replaced.

    Raises:
        InputError: one of them cannot be written.
    """
    with ExitStack() as files:
        for path, text in texts.items():
            files.enter_context(atomic_write(path)).write_text(replace_undecodable(text), encoding="utf-8")
        yield


def write_text(path: Path, text: str) -> None:
    """Write a text file, completely or not at all; raise `InputError` if it cannot be written.

    Args:
        path: path of the file.
        text: content of the file.
    """
    with atomic_write_all({path: text}):
        pass


def derived_folder(path: Path) -> Path:
    """Return the usual folder of results; it need not exist yet.

    Args:
        path: a session (results go beside it), a folder of sessions (results go into it), or a data file
            (results go into the current folder, because the file's folder may belong to somebody else).

    Raises:
        InputError: the folder is a symbolic link; see `refuse_link`.
    """
    if path.is_dir():
        return refuse_link(path / "study")
    return refuse_link(
        path.with_suffix("") if is_session(path) else Path(f"{path.name.split('.')[0]}-palpate")
    )


def refuse_link(folder: Path) -> Path:
    """Return a folder of results that nobody named, unless it is a symbolic link.

    Whoever sent a session may have put a link beside it, through which results would replace files of the
    same names in any other folder.

    Args:
        folder: usual folder of results; it need not exist yet.

    Raises:
        InputError: it is a symbolic link.
    """
    if folder.is_symlink():
        raise InputError(
            f"folder {folder}: is a symbolic link to {os.path.realpath(folder)}; to write results through "
            "the link, name the link with --out or --folder; otherwise remove the link"
        )
    return folder


def folder_to_fill(path: Path, out: Path | None, names: Iterable[str], *, force: bool) -> Path:
    """Return the folder of results if these files may be written there; it need not exist yet.

    Args:
        path: session or data file.
        out: folder from the user; None for the usual one.
        names: names of the files that may be written, or patterns for `Path.glob`.
        force: whether files with these names may be replaced in a folder that the user named.

    Raises:
        InputError: a file exists there and may not be replaced.
    """
    from palpate.estimation.study import Revisions  # noqa: PLC0415, takes half a second

    folder, own = out or derived_folder(path), out is None or Revisions(out).exists
    spare_files(folder, names, force=force or own, keep=[path])
    return folder


def folder_to_read(path: Path, folder: Path | None) -> Path:
    """Return the folder of saved revisions; it may hold none yet.

    Args:
        path: session or data file.
        folder: folder from the user; None for the usual one.

    Raises:
        InputError: the folder that the user named does not exist.
    """
    if folder is not None and not folder.is_dir():
        raise InputError(f"--folder {folder}: no such folder")
    return folder or derived_folder(path)
