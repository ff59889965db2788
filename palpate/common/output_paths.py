"""Where what is derived from a file lies: in a folder of its own name beside a session, or here.

Such a folder is palpate's own: what is in it is renewed. So is one that the user named, once revisions are
kept in it. In any other folder nothing is replaced without `--force`.
"""

from collections.abc import Iterable
from pathlib import Path

from estimation.data.file_kind import is_session
from estimation.study import Revisions
from palpate.common.files import spare_files
from robot_io.errors import InputError


def derived_folder(path: Path) -> Path:
    """The usual folder; it need not be there yet.

    Args:
        path: a session, which has a folder beside it; a folder of sessions, which has one in it; or a data
            file, whose own folder may be anybody's: what is derived from it goes into the current one.
    """
    if path.is_dir():
        return path / "study"
    return path.with_suffix("") if is_session(path) else Path(f"{path.name.split('.')[0]}-palpate")


def folder_to_fill(path: Path, out: Path | None, names: Iterable[str], *, force: bool) -> Path:
    """The derived folder, if these files can be put there; it need not be there yet.

    Args:
        path: session or data file.
        out: the folder that the user wants instead of the usual one.
        names: of the files that may be written; patterns as of `Path.glob`.
        force: whether files of these names may be replaced in a folder that the user named.

    Raises:
        InputError: a file is there that may not be replaced.
    """
    folder, own = out or derived_folder(path), out is None or Revisions(out).is_there
    spare_files(folder, names, force=force or own, keep=[path])
    return folder


def folder_to_read(path: Path, folder: Path | None) -> Path:
    """The folder in which revisions are kept, where there may be none yet.

    Raises:
        InputError: the folder that the user names is not there.
    """
    if folder is not None and not folder.is_dir():
        raise InputError(f"--folder {folder}: no such folder")
    return folder or derived_folder(path)
