"""Join tables of several files side by side."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import chain
from typing import Any

from palpate.estimation.data.column_names import is_unnamed
from palpate.estimation.data.file_columns import pa
from palpate.estimation.data.table import Table


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
