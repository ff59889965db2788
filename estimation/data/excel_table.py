"""Read an Excel workbook of measurements, whose sheets contain separate tables or parts of one table."""

import re
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
import pyarrow as pa
from python_calamine import CalamineSheet, CalamineWorkbook

from palpate.estimation.data.file_columns import FileColumns, check_size, list_first
from palpate.estimation.data.table_layout import matching_places, with_run
from palpate.estimation.data.text_dialect import (
    MIN_NUMBERS,
    TableBlock,
    TableLayout,
    are_signals,
    decimal_mark,
    find_layouts,
    is_footer,
    is_number,
    numbered_names,
    same_columns,
    thousands_ambiguity,
)
from palpate.robot_io.errors import InputError

_LOOKED_AT = 200  # first rows of a sheet in which the start of a table is searched
_MAX_CELLS = 30_000_000  # cells of a sheet including empty ones, since the reader stores all of them
_CELL = re.compile(r"([A-Z]{1,3})(\d{1,7})")
_BELOW = 8  # rows below a row of words that are examined
_MAX_SHEETS = 200
_BEGINNINGS = (b"PK", bytes.fromhex("D0CF11E0A1B11AE1"))  # of .xlsx, .ods (ZIP), and .xls, [MS-CFB] 2.2


@dataclass(frozen=True)
class _SheetTable:
    """Table of one sheet."""

    sheet: str  # name of the sheet
    layout: TableLayout
    rows: list[list[Any]]  # cells below the names
    preamble: tuple[str, ...]  # filled rows above the names, if it is the first table of the sheet
    decimal: str  # decimal mark of numbers that are stored as text
    numbers: list[int]  # row numbers in the sheet
    title: str  # name of the sheet, with the row number of the names if the sheet holds several tables
    in_rows: bool  # whether each row of the sheet holds a signal, so that `numbers` are those of columns


def read_excel_table(path: Path, selected: str) -> FileColumns:
    """Read the table of a workbook (.xlsx, .xlsm, .xls, .ods); sheets with the same columns are its runs.

    Args:
        path: path of the workbook.
        selected: name of the sheet to read; empty for the longest table.

    Raises:
        InputError: the workbook is too large, or no sheet has column names above rows of numbers.
    """
    _check_workbook(path)
    book = CalamineWorkbook.from_path(path)
    sheets = [book.get_sheet_by_name(name) for name in book.sheet_names[:_MAX_SHEETS]]
    tables = [table for sheet in sheets for table in _tables(sheet)]
    if not tables:
        raise InputError(
            f"{path}: no sheet has a row of column names above rows of numbers. Its sheets: "
            f"{list_first([repr(name) for name in book.sheet_names])}"
        )
    if selected in book.sheet_names and selected not in {table.sheet for table in tables}:
        raise InputError(
            f"--table {selected}: {path}: in this sheet, no row of column names is directly above rows of "
            "numbers; remove other cells above and beside the table"
        )
    blocks = [TableBlock(table.title, table.layout.names, len(table.rows)) for table in tables]
    chosen, omitted = same_columns(blocks, selected, path)
    same_tables = [tables[place] for place in chosen]
    first = max(same_tables, key=lambda table: len(table.rows))
    layout = first.layout
    rows = list[list[Any]]()
    for table in same_tables:
        order = matching_places(table.layout.names, layout.names)
        rows += [[row[n] for n in order] for row in table.rows]
    cells_by_column = ([row[place] for row in rows] for place in range(len(layout.names)))
    columns = [
        _column(path, name, cells, first.decimal)
        for name, cells in zip(layout.names, cells_by_column, strict=True)
    ]
    joined = pa.table(columns, names=list(layout.names))
    names = list(dict.fromkeys(table.sheet for table in same_tables))
    if len(same_tables) > 1:  # each sheet, or each table of a sheet, is a run
        parts, begin = [], 0
        for number, table in enumerate(same_tables, 1):
            label = table.sheet if len(names) == len(same_tables) else f"{table.sheet} {number}"
            parts.append(with_run(joined.slice(begin, len(table.rows)), label))
            begin += len(table.rows)
        joined = pa.concat_tables(parts)
    listed = list_first([repr(name) for name in names])
    notes = [f"sheet{'s' if len(names) > 1 else ''} {listed} of {len(book.sheet_names)}", *omitted]
    numbers = np.array([number for table in same_tables for number in table.numbers], dtype=np.int64)
    row_word = "column" if first.in_rows else "row"
    return FileColumns(
        joined, first.decimal, tuple(notes), layout.titles, numbers, row_word, preamble=first.preamble
    )


def _check_workbook(path: Path) -> None:
    """Raise an error if a file is too large, or no workbook: some machines name text files .xls."""
    with path.open("rb") as file:
        if not file.read(8).startswith(_BEGINNINGS):
            raise InputError(f"{path}: is not an Excel workbook; if it is a text file, rename it to .csv")
    if zipfile.is_zipfile(path):  # memory depends on the extent of a sheet, even if most cells are empty
        with zipfile.ZipFile(path) as archive:
            check_size(path, sum(entry.file_size for entry in archive.infolist()))
            for entry in archive.infolist():  # any entry may be a sheet
                height, width = _extent(archive.read(entry))
                if height * width > _MAX_CELLS:
                    raise InputError(
                        f"{path}: a sheet has {height} rows and {width} columns, too many to read; split it"
                    )


def _column(path: Path, name: str, cells: list[Any], decimal: str) -> pa.Array:
    """Convert the cells of a column to numbers if all are numbers, else to text."""
    if all(isinstance(cell, int | float) and not isinstance(cell, bool) for cell in cells):
        return pa.array([float(cell) for cell in cells])
    marked = (cell.strip() for cell in cells if isinstance(cell, str) and decimal in cell)
    largest = max((abs(cell) for cell in cells if isinstance(cell, int | float)), default=0.0)
    if ambiguity := thousands_ambiguity(marked, largest, decimal):
        raise InputError(
            f"{path}: column '{name}': the text {ambiguity}; store all cells of the column as numbers"
        )
    if any(isinstance(cell, datetime) for cell in cells):  # a date without time then means midnight
        cells = [datetime(*cell.timetuple()[:3]) if type(cell) is date else cell for cell in cells]
    return pa.array([_text(cell, decimal) for cell in cells])


def _extent(sheet: bytes) -> tuple[int, int]:
    """Return the largest row and column of a cell in XML; OpenDocument states how often cells repeat."""
    last, current = [0, 0], [0, 0]

    def begin(name: str, attributes: dict[str, str]) -> None:
        tag = name.rpartition(":")[2]
        if tag == "c" and (place := _CELL.fullmatch(attributes.get("r", ""))):
            column = 0
            for letter in place[1]:
                column = 26 * column + ord(letter) - ord("A") + 1
            last[:] = max(last[0], int(place[2])), max(last[1], column)
        elif tag == "table":
            current[:] = 0, 0
        elif tag == "table-row":
            current[:] = current[0] + int(attributes.get("table:number-rows-repeated", "1")), 0
        elif tag in {"table-cell", "covered-table-cell"}:
            current[1] += int(attributes.get("table:number-columns-repeated", "1"))
            if "office:value-type" in attributes:
                last[:] = max(last[0], current[0]), max(last[1], current[1])

    parser = expat.ParserCreate()
    parser.StartElementHandler = begin
    with suppress(expat.ExpatError):
        parser.Parse(sheet, True)
    return last[0], last[1]


def _tables(sheet: CalamineSheet) -> list[_SheetTable]:
    """Return the tables of a sheet in order, or else its first table of numbers without names."""
    rows: list[list[Any]] = sheet.to_python(skip_empty_area=True)
    decimal = _decimal_mark(rows)
    in_rows = len(rows) < _LOOKED_AT and are_signals(
        [[_text(cell, decimal) for cell in row] for row in rows], decimal
    )
    if in_rows:
        rows = [list(cells) for cells in zip(*rows, strict=True)]
    looked_at = set(range(min(len(rows), _LOOKED_AT)))
    for place, row in enumerate(rows):  # examine rows of words and the rows below them
        words = sum(isinstance(cell, str) and cell != "" for cell in row)
        if words > 1 and sum(isinstance(cell, int | float) for cell in row) < MIN_NUMBERS:
            looked_at.update(range(place, min(len(rows), place + _BELOW)))
    places = sorted(looked_at)
    head = [[_text(cell, decimal) for cell in rows[place]] for place in places]
    layouts = list(find_layouts(head, decimal))
    if not layouts:
        numbered = numbered_names(len(head[0]) if head else 0)
        first = next(find_layouts([numbered, *head], decimal), None)
        layouts = [TableLayout(first.names, first.first - 1, first.first - 1)] if first else []
    above = 1 + (sheet.start or (0, 0))[int(in_rows)]
    tables: list[_SheetTable] = []
    ends = [*(places[layout.header] for layout in layouts[1:]), len(rows)]
    for layout, end in zip(layouts, ends, strict=False):  # there may be no table
        width, counts = len(layout.names), is_number(head[layout.first][0], decimal)
        body = {place: rows[place][:width] for place in range(places[layout.first], end)}
        body = {place: row for place, row in body.items() if any(cell != "" for cell in row)}
        while body:
            if not is_footer([_text(cell, decimal) for cell in body[max(body)]], counts=counts):
                break
            body.popitem()
        filled = list(body.values())
        preamble = tuple("\t".join(row).strip() for row in head[: layout.header] if any(row) and not tables)
        numbers = [above + place for place in body]
        mark = _decimal_mark(filled)
        title = sheet.name + f":{above + places[layout.header]}" * (len(layouts) > 1)
        tables.append(_SheetTable(sheet.name, layout, filled, preamble, mark, numbers, title, in_rows))
    return [table for table in tables if table.rows]


def _decimal_mark(rows: Sequence[Sequence[Any]]) -> str:
    """Return the decimal mark of those numbers that are stored as text."""
    return decimal_mark([[cell for cell in row if isinstance(cell, str)] for row in rows[:_LOOKED_AT]])


def _text(cell: object, decimal: str) -> str:
    """Format a cell as in a CSV file with this decimal mark."""
    if isinstance(cell, timedelta):
        minutes, seconds = divmod(cell, timedelta(minutes=1))
        return f"{minutes // 60}:{minutes % 60:02}:{seconds.seconds:02}.{seconds.microseconds:06}"
    return repr(cell).replace(".", decimal) if isinstance(cell, float) else str(cell)
