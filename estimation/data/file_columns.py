"""Columns of one file, its size limits, and how to tell kinds of files."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from palpate.estimation.data.arrow import pa
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.whole_file import most_unpacked
from palpate.robot_io.types import IntArray

BAGS = (".mcap", ".db3")  # of ROS 2
MOST_BYTES = 2**30  # ten hours at 1 kHz; more is refused before the memory is full


@dataclass(frozen=True)
class FileColumns:
    """Columns of a file."""

    columns: pa.Table  # by their names; those of a text file are text
    decimal: str = "."  # mark in numbers that are text
    words: tuple[str, ...] = ()  # how the file is written, where that is worth a word
    titles: tuple[str, ...] = ()  # what stands above each column's name, such as that of a test
    # Number of each row in the file, as an editor or spreadsheet shows it, shape (n,); None to count from 1.
    rows: IntArray | None = None
    row_word: str = "row"  # what such a number counts: "row" or "line"


def is_bag(path: Path) -> bool:
    """Return whether a folder is one ROS 2 recording.

    Args:
        path: path of the folder.
    """
    return (path / "metadata.yaml").is_file() and any(part.suffix in BAGS for part in path.iterdir())


def most_bytes(path: Path) -> int:
    """Return the largest size that a file may unpack to.

    Args:
        path: path of the file; a packed one may hold less.
    """
    return min(MOST_BYTES, most_unpacked(path.stat().st_size))


def check_size(path: Path, size: int) -> None:
    """Reject a file that holds too many bytes.

    Args:
        path: path of the file, for the error.
        size: bytes that it holds.
    """
    most = most_bytes(path)
    if size > most:
        raise InputError(f"{path}: holds more than {most // 2**20} MiB; split it")


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Return a sort key by which numbers within names sort as numbers.

    Args:
        path: path to sort by its name.
    """
    words = "".join(char if char.isdecimal() else f" {char} " for char in path.name.lower()).split()
    return [(int(word), "") if word.isdecimal() else (-1, word) for word in words]


_MCAP_MAGIC = b"\x89MCAP"
_ROS = b"\x04\x00\x00\x00ros2"  # the profile, behind the magic number and the header's length
_HEAD_BYTES = 25


def is_session(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is or should be a session, by its ending or its first bytes.

    A recording of ROS 2 is an MCAP file too, but counts as a data file.

    Args:
        path: path of the file, which need not exist.
    """
    place = Path(path)
    if not place.is_file():
        return place.suffix == ".mcap"
    head = b""
    with suppress(OSError), place.open("rb") as file:  # whoever reads it says what is wrong
        head = file.read(_HEAD_BYTES)
    mcap = head.startswith(_MCAP_MAGIC)
    return (mcap or place.suffix == ".mcap") and not (mcap and _ROS in head)
