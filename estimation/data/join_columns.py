"""Join tables of several files side by side."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from palpate.estimation.data.column_names import channel_pairs, guess_columns, is_unnamed
from palpate.estimation.data.file_columns import natural_key, pa
from palpate.estimation.data.table import Table, read_table
from palpate.robot_io.errors import InputError

_MAX_NEIGHBORS = 20  # files of a folder that are looked at
_MAX_SIZE_RATIO = 20  # largest ratio of the sizes of two files with the same rows


def joined_columns(first: Table, further: Iterable[Table]) -> Table | None:
    """Join tables side by side; None if they differ in their rows, or in a column that both have.

    A column without a name is named after its file, such as `tau_3` for the third column of tau.csv,
    or `tau` for its only column.

    Args:
        first: table of the first file.
        further: tables of the other files, read as long as they fit.
    """
    columns, files = dict[str, Any](), list[str]()
    for table in chain([first], further):
        if len(table) != len(first) or table.decimal != first.decimal:
            return None
        stem = table.path.name.split(".")[0]
        for number, name in enumerate(table.names, 1):
            own_name = stem if len(table.names) == 1 else f"{stem}_{number}"
            column, called = table.columns.column(name), own_name if is_unnamed(name) else name
            if not columns.setdefault(called, column).equals(column):
                return None
        files.append(table.path.name)
    word = f"{len(files)} files with the same rows are joined side by side: {', '.join(files)}"
    return replace(first, path=first.path.parent, columns=pa.table(columns), notes=(word, *first.notes))


def _has_channel(table: Table) -> bool:
    return bool(channel_pairs({guess.key for guess in guess_columns(table.names) if guess.quantity}))


def completing_file(table: Table) -> Path | None:
    """Return a file of the same folder that completes a table to a channel; None if there is none.

    Args:
        table: a table without a channel.
    """
    if not table.path.is_file():
        return None
    size, ending = table.path.stat().st_size, table.path.suffix
    neighbors = sorted(
        (path for path in table.path.parent.iterdir() if path.suffix == ending and path != table.path),
        key=natural_key,
    )
    for path in neighbors[:_MAX_NEIGHBORS]:
        if path.is_file() and size / _MAX_SIZE_RATIO < path.stat().st_size < size * _MAX_SIZE_RATIO:
            with suppress(InputError):
                other = read_table(path)
                joined = joined_columns(table, [other])
                if joined and not _has_channel(other) and _has_channel(joined):
                    return path
    return None
