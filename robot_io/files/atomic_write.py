"""Files written as a whole, text for them, and the memory that a packed file may take."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_ALLOWED_BYTES = 128 * 1024**2  # allowed for every file: an hour of four columns at 1 kHz
_BYTES_PER_PACKED_BYTE = 20  # allowed in addition; noisy measurements need 2 to 5, steady signals 15


def max_unpacked_bytes(packed_bytes: int) -> int:
    """Compute how much memory a packed file may take [bytes].

    Args:
        packed_bytes: size of the file.
    """
    return _ALLOWED_BYTES + _BYTES_PER_PACKED_BYTE * packed_bytes


def replace_undecodable(text: str) -> str:
    """Replace the bytes of a file's name that are not UTF-8 with question marks.

    Args:
        text: text from a file's name.
    """
    return text.encode("utf-8", "replace").decode("utf-8")


@contextmanager
def atomic_write(path: Path, *, replace: bool = True) -> Iterator[Path]:
    """Write a file under a temporary name, which is yielded, and rename it once it is complete.

    Args:
        path: final name of the file.
        replace: whether an existing file is replaced.

    Raises:
        FileExistsError: a file exists and is not to be replaced.
        OSError: the file cannot be written.
    """
    # The name keeps its extension, from which writers choose the format.
    unfinished = path.with_name(f".{os.getpid()}.{os.urandom(4).hex()}.part.{path.name}")
    try:
        yield unfinished
        if replace:
            unfinished.replace(path)
        else:
            # A link fails if the name exists: of several programs that try at once, one succeeds.
            try:
                os.link(unfinished, path)
            except FileExistsError:
                raise
            except OSError:  # a file system without links
                with reserve_name(path):
                    if path.exists():
                        raise FileExistsError(path) from None
                    unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


@contextmanager
def reserve_name(path: Path) -> Iterator[None]:
    """Reserve a file name while it is created; raise `FileExistsError` if another program has it.

    Args:
        path: name of the file.
    """
    reservation = path.with_name(f".{path.name}.taken")
    reservation.touch(exist_ok=False)
    try:
        yield
    finally:
        reservation.unlink()
