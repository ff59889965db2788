"""Files that appear whole under their name, or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path, *, replace: bool = True) -> Iterator[Path]:
    """A name to write under; when all is written, the file gets its own name.

    What was there is replaced; or else a file that is there stays, whoever made it and when.

    Raises:
        FileExistsError: a file is there, and is not to be replaced.
        OSError: it cannot be written.
    """
    # The ending stays: it tells the format.
    unfinished = path.with_name(f".{os.getpid()}.{os.urandom(4).hex()}.part.{path.name}")
    try:
        yield unfinished
        if replace:
            unfinished.replace(path)
        else:
            _give_free_name(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def _give_free_name(unfinished: Path, path: Path) -> None:
    """Give a file a name that nobody has; of several programs that try at once, one succeeds."""
    try:
        os.link(unfinished, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        with held_name(path):
            if path.exists():
                raise FileExistsError(path) from None
            unfinished.replace(path)


@contextmanager
def held_name(path: Path) -> Iterator[None]:
    """Hold a name by a second file, for as long as it takes to give it to a file.

    FileExistsError: another program holds it.
    """
    taken = path.with_name(f".{path.name}.taken")
    taken.touch(exist_ok=False)
    try:
        yield
    finally:
        taken.unlink()
