"""How much a data file may hold once it is unpacked."""

from pathlib import Path

from robot_io.errors import InputError
from robot_io.files.unpacked import most_unpacked

MOST_BYTES = 2**30  # ten hours at 1 kHz; more is refused before the memory is full


def most_bytes(path: Path) -> int:
    """What a file may hold."""
    return min(MOST_BYTES, most_unpacked(path.stat().st_size))


def check_size(path: Path, size: int) -> None:
    """Refuse a file that holds more.

    Raises:
        InputError: `size` bytes are too many.
    """
    most = most_bytes(path)
    if size > most:
        raise InputError(f"{path}: holds more than {most // 2**20} MiB; cut it into pieces")
