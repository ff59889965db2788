"""Tables in JSON: records, columns, or rows of numbers; the longest of a file."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from palpate.estimation.data.array_files import arrow_of
from palpate.estimation.data.file_columns import FileColumns, check_size
from palpate.estimation.data.text_table import as_utf8
from palpate.robot_io.errors import InputError

_FEWEST = 3  # rows of a table


def read_json(path: Path) -> FileColumns:
    """The longest table of a JSON file, or the records of one that holds one in each line.

    A table is a list of records, whose nested values are called "joint.position"; a mapping of columns of
    equal length; or a list of rows, whose columns a list beside it may name.

    Args:
        path: of the file.

    Raises:
        InputError: it is too large, is no JSON, or holds no table.
    """
    check_size(path, path.stat().st_size)
    text = as_utf8(path.read_bytes(), path)[0].decode()
    try:
        content = json.loads(text)
    except ValueError as error:
        try:
            content = [json.loads(line) for line in text.splitlines() if line.strip()]
        except ValueError:
            raise InputError(f"{path}: is no JSON: {error}") from error
    tables = list(_tables(content))
    if not tables:
        raise InputError(
            f"{path}: holds no table: a list of records, columns of equal length, or rows of numbers"
        )
    columns = max(tables, key=lambda table: len(next(iter(table.values()))))
    arrays = {name: np.array(cells) for name, cells in columns.items()}
    return FileColumns(arrow_of({name: array for name, array in arrays.items() if array.ndim == 1}, path))


def _tables(content: object) -> Iterator[dict[str, list[Any]]]:
    """All tables in what a JSON file holds."""
    pending = [content]
    while pending:
        value = pending.pop()
        if isinstance(value, Mapping):
            lists = {str(key): part for key, part in value.items() if isinstance(part, list)}
            flat = {key: part for key, part in lists.items() if part and not isinstance(part[0], list | dict)}
            lengths = [len(part) for part in flat.values() if len(part) >= _FEWEST]
            for length in set(lengths):
                if lengths.count(length) > 1:
                    yield {key: part for key, part in flat.items() if len(part) == length}
            for part in lists.values():
                yield from _rows(part, [words for words in flat.values() if isinstance(words[0], str)])
            pending += [part for part in value.values() if isinstance(part, Mapping | list)]
        elif isinstance(value, list) and len(value) >= _FEWEST:
            if all(isinstance(record, Mapping) for record in value):
                records = [_flat(record) for record in value]
                names = dict.fromkeys(name for record in records for name in record)
                yield {name: [record.get(name) for record in records] for name in names}
            else:
                yield from _rows(value, [])


def _rows(rows: list[Any], names: list[list[str]]) -> Iterator[dict[str, list[Any]]]:
    """A list of rows of equal width as a table, called by the names of that number."""
    width = len(rows[0]) if rows and isinstance(rows[0], list) else 0
    if width > 1 and len(rows) >= _FEWEST and all(isinstance(r, list) and len(r) == width for r in rows):
        places = [f"column {number}" for number in range(1, width + 1)]
        called = next((some for some in names if len(set(some)) == width == len(some)), places)
        yield dict(zip(called, map(list, zip(*rows, strict=True)), strict=True))


def _flat(record: Mapping[str, Any]) -> dict[str, Any]:
    """A record with its nested values side by side."""
    flat: dict[str, Any] = {}
    pending: list[tuple[str, object]] = [("", record)]
    while pending:
        name, value = pending.pop()
        parts: list[tuple[str, object]] = []
        if isinstance(value, Mapping):
            parts = [(str(key), part) for key, part in value.items()]
        elif isinstance(value, list):
            parts = [(str(number), part) for number, part in enumerate(value)]
        else:
            flat[name] = value
        pending += [(f"{name}.{key}" if name else key, part) for key, part in reversed(parts)]
    return flat
