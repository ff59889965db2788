"""What is read of a data file, whatever its kind, before anything is known of what it means."""

from dataclasses import dataclass

import pyarrow as pa


@dataclass(frozen=True)
class FileColumns:
    """The columns of a file.

    Attributes:
        columns: by their names; those of a text file are text.
        decimal: mark in numbers that are text.
        words: how the file is written, where that is worth a word.
    """

    columns: pa.Table
    decimal: str = "."
    words: tuple[str, ...] = ()
