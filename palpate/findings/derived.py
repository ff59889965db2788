"""Where what is derived from a file lies: in a folder of its own name beside a session, or here.

Such a folder is palpate's own: what is in it is renewed. So is one that the user named, once revisions are
kept in it. In any other folder nothing is replaced without `--force`.
"""

from collections.abc import Iterable
from pathlib import Path

from palpate.files import spare_files
from palpate.findings.estimation_run import Material
from palpate.findings.revisions import RevisionShelf
from robot_io.errors import InputError


def derived_folder(material: Material, out: Path | None) -> Path:
    """The folder; it need not be there yet.

    Args:
        material: a session, which has a folder beside it, or a data file, whose own folder may be anybody's:
            what is derived from it goes into the current one.
        out: the folder that the user wants instead.
    """
    if out is not None:
        return out
    if material.session is not None:
        return material.session.derived_dir
    return Path(f"{material.path.name.split('.')[0]}-palpate")


def folder_to_fill(material: Material, out: Path | None, names: Iterable[str], *, force: bool) -> Path:
    """The derived folder, if these files can be put there; it need not be there yet.

    Args:
        material: as for `derived_folder`.
        out: as there.
        names: of the files that may be written; patterns as of `Path.glob`.
        force: whether files of these names may be replaced in a folder that the user named.

    Raises:
        InputError: a file is there that may not be replaced.
    """
    folder, own = derived_folder(material, out), out is None or RevisionShelf(out).is_there
    spare_files(folder, names, force=force or own, keep=[material.path])
    return folder


def kept_revisions(material: Material, folder: Path | None) -> RevisionShelf:
    """The revisions of a file.

    Args:
        material: a session or data file.
        folder: where the user says that they are kept; None for the usual place, where there may be none yet.

    Raises:
        InputError: the folder that the user names is not there.
    """
    if folder is not None and not folder.is_dir():
        raise InputError(f"--folder {folder}: no such folder")
    return RevisionShelf(derived_folder(material, folder))
