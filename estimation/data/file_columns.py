"""Columns of one file, size limits, and detection of file types."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.robot_io.errors import InputError
from palpate.robot_io.extras import LazyModule
from palpate.robot_io.files.atomic_write import max_unpacked_bytes
from palpate.robot_io.types import IntArray

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.csv as pa_csv
else:
    pa, pc, pa_csv = map(LazyModule, ("pyarrow", "pyarrow.compute", "pyarrow.csv"))

__all__ = ["pa", "pa_csv", "pc"]


BAGS = (".mcap", ".db3")  # endings of ROS 2 recordings
OTHER_LENGTHS = "columns of other lengths left out"
MAX_BYTES = 2**30  # size limit, ten hours at 1 kHz, to protect the memory


@dataclass(frozen=True)
class FileColumns:
    """Columns of a file."""

    columns: pa.Table  # columns by name; those of a text file contain text
    decimal: str = "."  # decimal mark of numbers that are text
    notes: tuple[str, ...] = ()  # notes on the format of the file
    titles: tuple[str, ...] = ()  # text above each column's name, such as the name of a test
    # Number of each row in the file, as an editor or spreadsheet shows it, shape (n,); None to count from 1.
    rows: IntArray | None = None
    row_word: str = "row"  # unit of these numbers: "row", "line", or "column" if each row holds a signal
    preamble: tuple[str, ...] = ()  # lines above the header


def list_first(items: Sequence[str], most: int = 8) -> str:
    """Join items by commas for a message; " ..." stands for those beyond the first ones.

    Args:
        items: the items, as text.
        most: largest number of items that are shown.
    """
    return ", ".join(items[:most]) + (" ..." if len(items) > most else "")


def is_bag(path: Path) -> bool:
    """Return whether a folder is a ROS 2 recording."""
    return (path / "metadata.yaml").is_file() and any(part.suffix in BAGS for part in path.iterdir())


def most_bytes(path: Path) -> int:
    """Return the largest allowed unpacked size of a file [bytes].

    Args:
        path: path of the file, which may be compressed.
    """
    return min(MAX_BYTES, max_unpacked_bytes(path.stat().st_size))


def check_size(path: Path, size: int) -> None:
    """Raise InputError if a file is too large.

    Args:
        path: path of the file.
        size: its unpacked size [bytes].
    """
    most = most_bytes(path)
    if size > most:
        raise InputError(f"{path}: holds more than the limit of {most // 2**20} MiB; split it")


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Return a sort key by which numbers within file names are ordered numerically."""
    words = "".join(char if char.isdecimal() else f" {char} " for char in path.name.lower()).split()
    return [(int(word), "") if word.isdecimal() else (-1, word) for word in words]


_MCAP_MAGIC = b"\x89MCAP"
_ROS = b"\x04\x00\x00\x00ros2"  # the profile, which follows the magic number and the header's length
_HEAD_BYTES = 25


def is_session(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a session, by its ending or its first bytes.

    A ROS 2 recording is also an MCAP file, but counts as a data file. If the file is missing, its ending
    decides.

    Args:
        path: path of the file, which need not exist.
    """
    place = Path(path)
    if not place.is_file():
        return place.suffix == ".mcap"
    head = b""
    with suppress(OSError), place.open("rb") as file:  # errors are reported when the file is read
        head = file.read(_HEAD_BYTES)
    mcap = head.startswith(_MCAP_MAGIC)
    return (mcap or place.suffix == ".mcap") and not (mcap and _ROS in head)
