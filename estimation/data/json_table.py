"""Read JSON tables: records, columns, or rows of numbers."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from palpate.estimation.data.array_files import arrow_table, matrix_columns
from palpate.estimation.data.column_names import RUN, TIME, guess_columns, split_unit
from palpate.estimation.data.file_columns import OTHER_LENGTHS, FileColumns, check_size
from palpate.estimation.data.text_dialect import numbered_names
from palpate.estimation.data.text_table import as_utf8
from palpate.robot_io.errors import InputError

_MIN_COUNT = 3  # least number of rows of a table


def read_json(path: Path) -> FileColumns:
    """Read the longest table of a JSON file, or the records of a file with one record per line.

    A table is a list of records, a mapping of columns of equal length, or a list of rows. Nested values of
    records get names such as "joint.position". An adjacent list may name the columns of rows. Several tables
    with a clock and the same columns, in a list or a mapping, are runs. A table may be in a list of its own.

    Args:
        path: path of the file.

    Raises:
        InputError: the file is too large, is not JSON, names a key twice, or has no table.
    """
    check_size(path, path.stat().st_size)
    text = as_utf8(path.read_bytes(), path)[0].decode()

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        names = [name for name, _ in pairs]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"{path}: the key '{twice:.60}' appears twice in one object; rename one")
        return dict(pairs)

    try:
        content = json.loads(text, object_pairs_hook=unique)
    except json.JSONDecodeError as error:
        content, lines = [], [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
        for number, line in lines:
            try:
                content.append(json.loads(line, object_pairs_hook=unique))
            except json.JSONDecodeError as line_error:
                follows_records = number > lines[0][0]  # the lines before it are records
                problem = f"line {number}: {line_error}" if follows_records else f"{error}"
                raise InputError(f"{path}: is not valid JSON: {problem}") from error
    tables = list(_tables(content))
    if not tables:
        raise InputError(
            f"{path}: holds no table; expected a list of records, columns of equal length, or rows of numbers"
        )
    columns, other_lengths = max(tables, key=lambda table: _length(table[0]))
    flat = {
        name: np.array(_truth_as_text(cells))
        for name, cells in columns.items()
        if not any(map(_is_nested, cells))
    }
    omitted = (f"{OTHER_LENGTHS}: {', '.join(other_lengths)}",) if other_lengths else ()
    return FileColumns(arrow_table(flat, path), notes=omitted)


def _truth_as_text(cells: list[Any]) -> list[Any]:
    """Write true and false among other values as text, as in CSV; an array would make them 1 and 0."""
    truths = sum(isinstance(cell, bool) for cell in cells)
    if not truths or truths == sum(cell is not None for cell in cells):
        return cells
    return [str(cell).lower() if isinstance(cell, bool) else cell for cell in cells]


def _is_nested(value: object) -> TypeGuard[list[Any] | Mapping[str, Any]]:
    return isinstance(value, list | Mapping)


_Found = tuple[dict[str, list[Any]], list[str]]  # a table, and the names of lists that have another length


def _tables(content: object) -> Iterator[_Found]:
    """Yield all tables in a JSON document."""
    pending = [content]
    while pending:
        value = pending.pop()
        yield from _runs(value)
        yield from _tables_in(value)
        if isinstance(value, Mapping) or (isinstance(value, list) and len(value) == 1):
            pending += filter(_is_nested, value.values() if isinstance(value, Mapping) else value)


def _tables_in(value: object) -> Iterator[_Found]:
    """Yield the tables of one mapping or list, without those of its parts."""
    if isinstance(value, Mapping):
        lists = {str(key): part for key, part in value.items() if isinstance(part, list)}
        flat = {key: part for key, part in lists.items() if part and not any(map(_is_nested, part))}
        for key, part in lists.items():
            if _width(part) and len(part) in map(len, flat.values()):  # a matrix beside its clock
                columns = matrix_columns(key, np.array(part, dtype=object))
                flat |= {name: values.tolist() for name, values in columns.items()}
        lengths = [len(part) for part in flat.values() if len(part) >= _MIN_COUNT]
        for length in set(lengths):
            if lengths.count(length) > 1:
                other_lengths = [key for key, part in flat.items() if _MIN_COUNT <= len(part) != length]
                yield {key: part for key, part in flat.items() if len(part) == length}, other_lengths
        names = [words for words in flat.values() if isinstance(words[0], str)]
        for part in lists.values():
            yield from ((table, []) for table in _rows(part, names))
    elif isinstance(value, list) and len(value) >= _MIN_COUNT:
        if all(isinstance(record, Mapping) for record in value):
            records = [_flatten(record) for record in value]
            every = dict.fromkeys(name for record in records for name in record)
            yield {name: [record.get(name) for record in records] for name in every}, []
        else:
            yield from ((table, []) for table in _rows(value, []))


def _runs(parts: object) -> Iterator[_Found]:
    """Yield one table of all parts of a list or mapping if they have the same columns and each a clock."""
    items = (
        parts.items() if isinstance(parts, Mapping) else enumerate(parts if isinstance(parts, list) else ())
    )
    named = {str(key): part for key, part in items if isinstance(part, Mapping)}
    runs: dict[str, dict[str, list[Any]]] = {}
    for key, part in named.items() if len(named) > 1 else ():
        tables = [table for value in (part, *part.values()) for table, _ in _tables_in(value)]
        runs[key] = max(tables, key=_length, default={})
        names = list(next(iter(runs.values())))
        if set(runs[key]) != set(names) or not any(guess.key == TIME for guess in guess_columns(names)):
            return
    if runs and RUN not in names:
        joined = {name: [cell for run in runs.values() for cell in run[name]] for name in names}
        yield joined | {RUN: [key for key, run in runs.items() for _ in range(_length(run))]}, []


def _length(table: Mapping[str, list[Any]]) -> int:
    return len(next(iter(table.values())))


def _width(rows: list[Any]) -> int:
    """Return the length of equally long rows; 0 for other lists."""
    width = len(rows[0]) if rows and isinstance(rows[0], list) else 0
    alike = all(isinstance(row, list) and len(row) == width and not any(map(_is_nested, row)) for row in rows)
    return width if alike else 0


def _rows(rows: list[Any], names: list[list[str]]) -> Iterator[dict[str, list[Any]]]:
    """Convert a list of equally long rows to a table; its first row or a list of names gives the names."""
    if (width := _width(rows)) > 1 and len(rows) >= _MIN_COUNT:
        if all(isinstance(cell, str) for cell in rows[0]):
            names, rows = [rows[0], *names], rows[1:]
        header = next((row for row in names if len(set(row)) == width == len(row)), numbered_names(width))
        yield dict(zip(header, map(list, zip(*rows, strict=True)), strict=True))


def _flatten(record: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten nested values of a record."""
    flat: dict[str, Any] = {}
    pending: list[tuple[str, object]] = [("", record)]
    while pending:
        name, value = pending.pop()
        if not _is_nested(value):
            flat[name] = value
            continue
        if isinstance(value, Mapping):
            parts = [(f"{name}.{key}" if name else str(key), part) for key, part in value.items()]
        else:  # "position_rad" has the elements "position.0 [rad]", "position.1 [rad]" ...
            stem, unit = split_unit(name)
            ending = f" [{unit}]" if unit else ""
            parts = [(f"{stem}.{number}{ending}", part) for number, part in enumerate(value)]
        pending += reversed(parts)
    return flat
