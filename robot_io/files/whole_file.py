"""Files written as a whole, text for them, and the memory that a packed file may take."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_ALWAYS = 128 * 1024**2  # bytes that every file may hold: an hour of four columns at 1 kHz
_TIMES = 20  # times the packed size; noisy measurements come to 2 to 5, steady signals to 15


def most_unpacked(packed_bytes: int) -> int:
    """Compute how much memory a packed file may take.

    Args:
        packed_bytes: size of the file.

    Returns:
        Largest unpacked size [bytes].
    """
    return _ALWAYS + _TIMES * packed_bytes


def as_utf8(text: str) -> str:
    """Replace bytes of a file's name that UTF-8 cannot hold by question marks.

    Args:
        text: text from a file's name.

    Returns:
        Text that can be encoded.
    """
    return text.encode("utf-8", "replace").decode("utf-8")


@contextmanager
def whole_file(path: Path, *, replace: bool = True) -> Iterator[Path]:
    """Give a temporary name to write under; the finished file is renamed on exit.

    Args:
        path: final name of the file.
        replace: whether an existing file is replaced.

    Yields:
        The temporary name.

    Raises:
        FileExistsError: a file exists and is not to be replaced.
        OSError: the file cannot be written.
    """
    # The ending stays: it tells the format.
    unfinished = path.with_name(f".{os.getpid()}.{os.urandom(4).hex()}.part.{path.name}")
    try:
        yield unfinished
        if replace:
            unfinished.replace(path)
        else:
            # Rename a file to an unused name; of several programs that try at once, one succeeds.
            try:
                os.link(unfinished, path)
            except FileExistsError:
                raise
            except OSError:  # a file system without links
                with held_name(path):
                    if path.exists():
                        raise FileExistsError(path) from None
                    unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


@contextmanager
def held_name(path: Path) -> Iterator[None]:
    """Hold a name by a second file, for as long as it takes to give it to a file.

    Args:
        path: the name.

    Raises:
        FileExistsError: another program uses it.
    """
    taken = path.with_name(f".{path.name}.taken")
    taken.touch(exist_ok=False)
    try:
        yield
    finally:
        taken.unlink()
