"""What is read of a data file, whatever its kind and at most, before anything is known of what it means."""

from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from robot_io.errors import InputError
from robot_io.files.unpacked import most_unpacked

MOST_BYTES = 2**30  # ten hours at 1 kHz; more is refused before the memory is full


@dataclass(frozen=True)
class FileColumns:
    """The columns of a file."""

    columns: pa.Table  # by their names; those of a text file are text
    decimal: str = "."  # mark in numbers that are text
    words: tuple[str, ...] = ()  # how the file is written, where that is worth a word


def most_bytes(path: Path) -> int:
    """What a file may hold."""
    return min(MOST_BYTES, most_unpacked(path.stat().st_size))


def check_size(path: Path, size: int) -> None:
    """Refuse a file that holds more. InputError: `size` bytes are too many."""
    most = most_bytes(path)
    if size > most:
        raise InputError(f"{path}: holds more than {most // 2**20} MiB; cut it into pieces")
