"""Folders created for outputs; those that stay empty are removed at the end of the command."""

from contextlib import suppress
from pathlib import Path

_made: list[Path] = []  # in this process; innermost first


def make_folder(folder: Path) -> None:
    """Make a folder and those that it is in, and remember which of them are new.

    Raises:
        OSError: it cannot be made.
    """
    place = folder.absolute()
    new = [path for path in (place, *place.parents) if not path.exists()]
    _made[:0] = new
    folder.mkdir(parents=True, exist_ok=True)


def remove_empty_folders() -> None:
    """Leave nothing behind where nothing came of a command; what holds anything stays."""
    for folder in _made:
        with suppress(OSError):  # there is something in it, or it was never made
            folder.rmdir()
    _made.clear()
