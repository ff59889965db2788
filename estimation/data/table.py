"""Read a file of measurements as named columns: text, Excel, Parquet, NPZ, MATLAB, JSON, ZIP or ROS 2."""

from __future__ import annotations

import os
import re
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from palpate.estimation.data.array_files import read_groups, read_mat, read_npz, read_parquet
from palpate.estimation.data.column_names import RUN, Role, guess_columns, is_unnamed
from palpate.estimation.data.file_columns import (
    BAGS,
    FileColumns,
    check_size,
    is_bag,
    list_first,
    natural_key,
    pa,
    pc,
)
from palpate.estimation.data.grouped_files import hdf5_content, tdms_content
from palpate.estimation.data.json_table import read_json
from palpate.estimation.data.names_beside_numbers import names_beside_numbers
from palpate.estimation.data.table_layout import (
    CLOCK_MARK,
    find_tests,
    is_filled,
    is_text,
    stack_tests,
    with_run,
    with_seconds,
)
from palpate.estimation.data.text_dialect import (
    MIN_UNMARKED,
    NAMELESS,
    TableBlock,
    same_columns,
    thousands_ambiguity,
)
from palpate.estimation.data.text_table import as_utf8, number_of, read_text_table
from palpate.estimation.data.units import describe_fault, invalid_rows
from palpate.robot_io.errors import InputError, UnknownNameError
from palpate.robot_io.extras import LazyModule
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_SHOWN = 60  # characters of a value in an error message
_MAX_LABEL_LENGTH = 1000  # characters of the name of a run or a phase
_MAX_NAMES = 20  # names that an error message lists
_HEAD_BYTES = 1 << 14
_MAX_MEMBERS = 2000  # files of an archive
_LOOKED_AT = 100  # first filled rows that decide whether a column contains numbers
_GROUPED = {  # numbers with thousands separators, by the separator
    ",": r"^[+-]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?$",
    ".": r"^[+-]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?$",
}
_BLANKS = "[ \u00a0\u202f]"  # blanks used as thousands separators
_BLANKS_GROUP = rf"^[+-]?[1-9]\d{{0,2}}({_BLANKS}\d{{3}})+([.,]\d*)?([eE][+-]?\d+)?$"
_HAS_POINT_TOO = r",\d{3}\.\d+$"  # a comma before a decimal point is not a decimal comma
_HUNDREDS, _UNGROUPED = r"^[+-]?[1-9]\d\d(\.|$)", r"^[+-]?\d{4}"  # of which only the first go with "1,000"


@dataclass(frozen=True)
class Table(FileColumns):
    """Columns of a file with unique names, whose clock times are seconds."""

    path: Path = field(kw_only=True)  # source of the table, for error messages
    rows: IntArray = field(kw_only=True)  # number of each row in the file, shape (n,)
    _numbers: dict[str, FloatArray] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.rows)

    def row_name(self, row: int | np.integer[Any]) -> str:
        """Return a row as an editor or spreadsheet numbers it, such as "line 7".

        Args:
            row: index of the row, from 0.
        """
        return f"{self.row_word} {self.rows[row]}"

    def place(self, row: int | np.integer[Any], name: str) -> str:
        """Return file, row and column of a cell, as error messages begin.

        Args:
            row: index of the row, from 0.
            name: name of the column.
        """
        return f"{self.path}: {self.row_name(row)}, column '{name}'"

    def note_left_out(self, rows: IntArray, reason: str) -> str:
        """Return a note on rows that are not used.

        Args:
            rows: indices of these rows, at least one; the note states the first.
            reason: why they are not used.
        """
        first = self.row_name(rows[0])
        return f"{len(rows)} of {len(self)} rows left out: {reason}; the first is in {first}"

    @property
    def listed_names(self) -> str:
        """Names for an error message, shortened if there are many."""
        more = f" and {len(self.names) - _MAX_NAMES} more" if len(self.names) > _MAX_NAMES else ""
        return ", ".join(self.names[:_MAX_NAMES]) + more

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in their order."""
        return tuple(self.columns.column_names)

    @cached_property
    def clocks(self) -> frozenset[str]:
        """Names of the columns that were converted from clock times to seconds."""
        marked = (each for each in self.columns.schema if (each.metadata or {}).items() >= CLOCK_MARK.items())
        return frozenset(each.name for each in marked)

    @cached_property
    def guesses(self) -> list[Role]:
        """Guessed quantity of each column, see `guess_columns`."""
        return guess_columns(self.names, self.clocks)

    def numbers(self, name: str) -> FloatArray:
        """Return a column as numbers, shape (n,), read-only; text is converted once.

        Args:
            name: name of the column.

        Raises:
            InputError: there is no such column, or a value is missing or not a finite number.
        """
        if name not in self._numbers:
            column = self._column(name)
            try:
                numbers = None
                if self.decimal == "." or not is_text(column.type):
                    with suppress(pa.ArrowInvalid):  # fast path for plain numbers without separators
                        numbers = pc.cast(column, pa.float64())
                if numbers is None:
                    trimmed = pc.utf8_trim_whitespace(_with_decimal_points(column, self.decimal))
                    numbers = pc.cast(trimmed, pa.float64())
                values = np.asarray(numbers.to_numpy(zero_copy_only=False), dtype=np.float64)
            except (pa.ArrowException, TypeError, ValueError):
                column = _with_decimal_points(column, self.decimal)
                values = np.array([number_of(text) for text in column.to_pylist()], dtype=np.float64)
            if len(bad := invalid_rows(values)):
                excerpt = str(column[int(bad[0])].as_py())[:_SHOWN]
                fault = describe_fault(number_of(excerpt), len(bad))
                remedy = _remedy(excerpt, whole=len(bad) == len(values))
                raise InputError(f"{self.place(bad[0], name)}: {excerpt!r} is {fault}; {remedy}")
            if is_text(self._column(name).type):  # "1.000" after "999" may be read a thousand times too small
                trimmed = pc.utf8_trim_whitespace(self._column(name))
                marked = np.asarray(pc.match_substring(trimmed, self.decimal).fill_null(False))
                unmarked = np.where(marked, 0.0, np.abs(values))
                cells = (str(trimmed[row]) for row in np.flatnonzero(marked).tolist())
                if ambiguity := thousands_ambiguity(cells, float(unmarked.max(initial=0.0)), self.decimal):
                    whole = trimmed[int(np.argmax(unmarked >= MIN_UNMARKED))]
                    raise InputError(
                        f"{self.place(np.argmax(marked), name)}: {ambiguity}, because numbers such as "
                        f"'{whole}' have no decimal mark; write numbers without thousands separators"
                    )
            values.setflags(write=False)
            self._numbers[name] = values
        return self._numbers[name]

    def varies(self, name: str) -> bool:
        """Return whether a column contains numbers that are not all equal.

        Args:
            name: name of the column; False if it does not exist, or a value is not a number.
        """
        try:
            return bool(np.ptp(self.numbers(name)) > 0.0)
        except InputError:
            return False

    def labels(self, name: str) -> tuple[tuple[str, ...], IntArray]:
        """Return the distinct texts of a column in order of appearance, and the index of each row's text.

        Args:
            name: name of the column.

        Raises:
            InputError: there is no such column, or a text is too long for a label.
        """
        column, place = self._column(name), f"{self.path}: column '{name}'"
        kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
        try:
            coded = column.cast(kind).dictionary_encode("encode").combine_chunks()
        except pa.ArrowException as error:
            raise InputError(f"{place} holds {kind!s:.60}, expected text or numbers") from error
        texts = [  # whole numbers without decimal point, so that run labels are equal in all formats
            str(int(value))
            if isinstance(value, float) and value.is_integer()
            else " ".join(str(value).split())
            for value in coded.dictionary.to_pylist()
        ]
        longest = max(map(len, texts), default=0)
        if longest > _MAX_LABEL_LENGTH:
            raise InputError(
                f"{place}: a name has {longest} characters; at most {_MAX_LABEL_LENGTH} are allowed"
            )
        number = {text: number for number, text in enumerate(dict.fromkeys(texts))}
        number_by_code = np.array([number[text] for text in texts], dtype=np.int64)
        return tuple(number), number_by_code[coded.indices.to_numpy(zero_copy_only=False)]

    def select(self, chosen: BoolArray) -> Table:
        """Return the table with only some rows.

        Args:
            chosen: rows to keep, a mask of shape (n,).
        """
        return replace(self, columns=self.columns.filter(pa.array(chosen)), rows=self.rows[chosen])

    def head(self, rows: int) -> Table:
        """Return the table with only its first rows.

        Args:
            rows: number of rows to keep.
        """
        return replace(self, columns=self.columns.slice(0, rows), rows=self.rows[:rows])

    def filled_rows(self, name: str) -> BoolArray:
        """Return the mask of rows in which a column is not empty, shape (n,).

        Args:
            name: name of the column.

        Raises:
            UnknownNameError: there is no such column.
        """
        return is_filled(self._column(name))

    def numeric_share(self, name: str) -> float:
        """Return the share of usable numbers among a column's first filled cells; 0 if it is empty.

        Args:
            name: name of the column.

        Raises:
            UnknownNameError: there is no such column.
        """
        filled = np.flatnonzero(self.filled_rows(name))[:_LOOKED_AT]
        cells = _with_decimal_points(self._column(name).take(filled), self.decimal).to_pylist()
        numbers = np.array([number_of(cell) for cell in cells], dtype=np.float64)
        if any("," in str(cell) for cell in cells) and self.varies(name):
            return 1.0  # the whole column decides whether commas group thousands
        return 1.0 - len(invalid_rows(numbers)) / len(numbers) if len(numbers) else 0.0

    def _column(self, name: str) -> pa.ChunkedArray:
        try:
            return self.columns.column(name)
        except KeyError:
            close = get_close_matches(name, self.names, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise UnknownNameError(
                f"{self.path}: no column '{name}'{hint or '.'} Available: {self.listed_names}"
            ) from None


def read_table(path: str | os.PathLike[str], selected: str = "") -> Table:
    """Read a data file; the ending of its name determines the format.

    Args:
        path: path of the file.
        selected: sheet or header line of the table to read; empty for the longest table.

    Raises:
        InputError: the file cannot be read, is empty, or has an unknown format.
    """
    place = Path(path)
    bag = place.is_dir() and is_bag(place)
    if not (bag or place.is_file()):
        raise InputError(f"{place}: no such file")
    ending = BAGS[0] if bag else Path(place.name.lower().removesuffix(".gz")).suffix
    read = next((reader for endings, reader in _READERS if ending in endings), None)
    if read is None and _is_text(place):
        read = read_text_table
    if read is None:
        known = ", ".join((*ENDINGS, *_NOT_IN_FOLDERS))
        raise InputError(
            f"{place}: unknown kind of file. Valid: {known}; a text file may be compressed, such as .csv.gz"
        )
    several = read in {read_text_table, _read_excel, _read_zip}
    if selected and not several:
        raise InputError(f"--table {selected}: {place} holds one table only")
    try:
        return table_of(read(place, selected) if several else read(place), place)
    except InputError:
        raise
    except Exception as error:  # libraries may raise almost any exception for a broken file
        reason = " ".join(str(error).split())[:200] or f"it is damaged or cut off ({type(error).__name__})"
        raise InputError(f"{place}: cannot be read: {reason}") from error


def table_of(file: FileColumns, path: Path) -> Table:
    """Build a table from the columns of a file: clock times become seconds, tests side by side become runs.

    Args:
        file: columns of the file.
        path: path of the file, for error messages.

    Raises:
        InputError: the table has no rows.
    """
    words = names_beside_numbers(file)
    named = (words.get(place, name) for place, name in enumerate(file.columns.column_names, 1))
    columns = file.columns.rename_columns([" ".join(name.split()) for name in named])
    used = [  # omit columns that have neither a name nor a value
        place
        for place, name in enumerate(columns.column_names)
        if name != f"column {place + 1}" or is_filled(columns.column(place)).any()
    ]
    columns = columns.select(used)
    names, lines = columns.column_names, len(file.preamble)
    is_nameless = {is_unnamed(name) for name in names if name != RUN} == {True}
    notes = ["columns named by the words above or before their numbers"] if words else []
    notes += [NAMELESS] if is_nameless and NAMELESS not in file.notes else []
    notes += [f"{lines} line{'s' if lines > 1 else ''} above the header"] if lines else []
    notes += ["each row holds a signal"] if file.row_word == "column" else []
    notes += file.notes
    rows = np.arange(1, columns.num_rows + 1) if file.rows is None else file.rows
    tests = find_tests(names)
    pairs = [(tests[0][name], place) for test in tests for name, place in test.items()]
    if any(names[a] != names[b] or not columns[a].equals(columns[b]) for a, b in pairs):  # else copies
        columns, places = stack_tests(columns, tests, file.titles, file.decimal)
        names, rows = columns.column_names, rows[places]
        notes.append(f"{len(tests)} tests side by side, read as runs")
    unique: list[str] = []  # unique names: the second "GPa" becomes "GPa (2)"
    for name in names:
        number = unique.count(name) and 2
        while number and f"{name} ({number})" in {*names, *unique}:
            number += 1
        unique.append(f"{name} ({number})" if number else name)
    columns = columns.rename_columns(unique)
    if columns.num_rows == 0:
        raise InputError(f"{path}: no rows of data")
    columns, clocks = with_seconds(columns, file.decimal)
    changed = {"columns": columns, "notes": (*notes, *clocks), "rows": rows}
    return Table(path=path, **vars(file) | changed)


def _is_text(path: Path) -> bool:
    """Return whether a file contains text, regardless of its name."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    try:
        return bool(as_utf8(head, path)[0].strip()) and not head.startswith(b"%PDF")
    except InputError:
        return False


def _read_excel(path: Path, selected: str) -> FileColumns:
    if path.name.lower().endswith(".xls") and _is_text(path):  # some machines name text files .xls
        return read_text_table(path, selected)
    from palpate.estimation.data.excel_table import read_excel_table  # noqa: PLC0415, seldom needed

    return read_excel_table(path, selected)


def _remedy(excerpt: str, *, whole: bool) -> str:
    if excerpt.count(",") == 1 and not np.isnan(number_of(excerpt.replace(",", "."))):
        return "write numbers with a decimal point, not a comma"
    if whole and re.fullmatch(r"[+-]?[\d.,]+ ?[^\d\s]{1,6}", excerpt.strip()):
        return "write the unit in the column name, and only numbers below it"
    if whole:
        return "that column holds no numbers at all; name another column with --column"
    return "remove such rows, or choose others with --where"


def _with_decimal_points(column: pa.ChunkedArray, decimal: str) -> pa.ChunkedArray:
    """Convert numbers in text to a decimal point without thousands separators; keep other columns."""
    if not is_text(column.type):
        return column
    trimmed, mark = pc.utf8_trim_whitespace(column), "." if decimal == "," else ","
    has_blanks = pc.match_substring_regex(trimmed, _BLANKS_GROUP)
    if pc.any(has_blanks).as_py():
        column = trimmed = pc.if_else(has_blanks, pc.replace_substring_regex(trimmed, _BLANKS, ""), trimmed)
    grouped = pc.match_substring_regex(trimmed, _GROUPED[mark])
    if decimal == ",":
        separated = pc.any(pc.and_not(pc.match_substring(trimmed, mark), grouped)).as_py()
        plain = trimmed if separated else pc.replace_substring(trimmed, mark, "")
        return pc.replace_substring(plain, decimal, ".")
    has_point, hundreds, ungrouped = (
        pc.any(pc.match_substring_regex(trimmed, pattern)).as_py()
        for pattern in (_HAS_POINT_TOO, _HUNDREDS, _UNGROUPED)
    )
    is_grouped = not pc.any(pc.and_not(pc.match_substring(trimmed, mark), grouped)).as_py()
    if not has_point and not (is_grouped and hundreds and not ungrouped):
        return column
    return pc.if_else(grouped, pc.replace_substring(trimmed, mark, ""), trimmed)


def _read_zip(path: Path, selected: str) -> FileColumns:
    """Read the longest (or selected) table of a ZIP archive; other files with its columns are further runs.

    Each file is unpacked under a name of its own, never under its path in the archive.
    """
    with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory() as folder:
        members = list[zipfile.ZipInfo]()
        for entry in archive.infolist():
            place = PurePosixPath(entry.filename.lower().removesuffix(".gz"))
            is_hidden = any(part.startswith((".", "__")) for part in place.parts)  # "__": made by macOS
            members += [entry] * (place.suffix in _UNPACKED and not is_hidden)
        if len(members) > _MAX_MEMBERS:
            raise InputError(f"{path}: holds {len(members)} files; at most {_MAX_MEMBERS} are read")
        check_size(path, sum(entry.file_size for entry in members))
        members.sort(key=lambda entry: natural_key(Path(entry.filename)))
        tables, faults = dict[str, Table](), list[str]()
        for number, entry in enumerate(members):
            name = entry.filename.lower()
            ending = PurePosixPath(name.removesuffix(".gz")).suffix + ".gz" * name.endswith(".gz")
            unpacked = Path(folder) / f"{number}{ending}"
            # `archive.read` returns at most the stated size, and raises BadZipFile for another content.
            unpacked.write_bytes(archive.read(entry))
            try:
                tables[entry.filename] = read_table(unpacked)
            except InputError as error:
                faults.append(str(error).replace(str(unpacked), entry.filename))
    if not tables:
        raise InputError(
            faults[0] if faults else f"{path}: holds no data file; valid: {', '.join(_UNPACKED)}"
        )
    blocks = [TableBlock(name, table.names, len(table)) for name, table in tables.items()]
    chosen, notes = same_columns(blocks, selected, path)
    used = [table for number, table in enumerate(tables.values()) if number in chosen]
    first = used[0]
    if len({table.decimal for table in used}) > 1:
        raise InputError(f"{path}: some files use decimal points and others commas; select one with --table")
    labels = [blocks[number].title for number in chosen]
    parts = [table.columns.select(first.names) for table in used]
    if len(parts) > 1:
        names = [PurePosixPath(label).name for label in labels]
        names = names if len(set(names)) == len(names) else labels
        parts = [with_run(part, name) for part, name in zip(parts, names, strict=True)]
        notes.insert(0, f"{len(parts)} files of the archive, read as runs: {list_first(labels)}")
    else:
        notes.insert(0, f"file '{labels[0]}' of the archive")
    notes += [f"{len(faults)} files not read, the first: {faults[0]}"] if faults else []
    columns = pa.concat_tables(parts, promote_options="permissive")
    return FileColumns(columns, first.decimal, (*notes, *first.notes))


_ros_bag = LazyModule("palpate.estimation.data.ros_bag")
_JSON = (".json", ".jsonl")
_READERS: tuple[tuple[tuple[str, ...], Callable[..., FileColumns]], ...] = (
    ((".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm", ".log", ".tra"), read_text_table),
    ((".xlsx", ".xlsm", ".xls", ".ods"), _read_excel),
    ((".parquet", ".pq"), read_parquet),
    ((".npz",), read_npz),
    ((".mat",), read_mat),
    ((".h5", ".hdf5"), lambda path: read_groups(hdf5_content(path), path)),
    ((".tdms",), lambda path: read_groups(tdms_content(path), path)),
    ((".zip",), _read_zip),
    (BAGS, lambda path: _ros_bag.read_ros_table(path)),  # noqa: PLW0108, imported when it is used
    (_JSON, read_json),
)
_NOT_IN_FOLDERS = (*_JSON, ".zip")  # files in a folder that describe it, or repeat its files
ENDINGS = tuple(ending for endings, _ in _READERS for ending in endings if ending not in _NOT_IN_FOLDERS)
"""Endings of data files in a folder."""
_UNPACKED = tuple(ending for ending in ENDINGS if ending not in BAGS)  # files that are read from an archive
