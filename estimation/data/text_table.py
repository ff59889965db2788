"""A text file of measurements: separated by commas, semicolons or tabs, packed or not."""

import gzip
import math
from pathlib import Path

import pyarrow as pa
import pyarrow.csv

from robot_io.errors import InputError
from robot_io.files.unpacked import most_unpacked

MOST_BYTES = 2**30  # unpacked: ten hours at 1 kHz; more is refused before the memory is full
_DELIMITERS = (",", ";", "\t")
_LONGEST_LINE = 2**20 - 1  # bytes; the reader takes blocks of 1 MiB, and the line must end in one
_SHOWN = 60  # characters of a line that is refused


def read_text_table(path: Path) -> pa.Table:
    """The columns of a text file as text, by the names in its first line.

    Raises:
        InputError: it is too large, is no UTF-8 text, has no header, or a row has too few or too many cells.
    """
    content = _content(path)
    ends = [place for place in (content.find(b"\n"), content.find(b"\r")) if place >= 0]
    end = min(ends, default=len(content))
    names, delimiter = _header(content[:end], path)
    if not content[end:].strip():
        raise InputError(f"{path}: no rows of data")
    try:
        return _parse(content, names, delimiter)
    except pa.ArrowInvalid as error:
        _text_of(content, path)
        problem = _first_bad_row(content, names, delimiter) or " ".join(str(error).split())[:200]
        raise InputError(f"{path}: {problem}") from error


def most_bytes(path: Path) -> int:
    """What a file may hold once it is unpacked."""
    return min(MOST_BYTES, most_unpacked(path.stat().st_size))


def number_of(text: object) -> float:
    """The number that a cell says, NaN if it says none."""
    written = str(text).strip()
    try:
        return math.nan if "_" in written else float(written)
    except ValueError:
        return math.nan


def _content(path: Path) -> bytes:
    open_file = gzip.open if path.name.lower().endswith(".gz") else open
    with open_file(path, "rb") as file:
        content: bytes = file.read(most_bytes(path) + 1)
    if len(content) > most_bytes(path):
        raise InputError(f"{path}: more than {most_bytes(path) // 2**20} MiB of text; cut it into pieces")
    return content


def _header(line: bytes, path: Path) -> tuple[list[str], str]:
    if len(line) > _LONGEST_LINE:
        raise InputError(f"{path}: its first line is longer than 1 MiB; put the names of the columns there")
    header = _text_of(line, path)
    delimiter = max(_DELIMITERS, key=header.count)
    names = [name.strip().strip('"') for name in header.split(delimiter)]
    if all(not math.isnan(number_of(name)) for name in names):
        raise InputError(f"{path}: the first line holds numbers; put the names of the columns there")
    return names, delimiter


def _text_of(content: bytes, path: Path) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is no UTF-8 text; save it as CSV in UTF-8") from None


class _Collector:
    """Takes the rows with a wrong number of cells, so that reading goes on."""

    def __init__(self) -> None:
        self.rows: list[pa.csv.InvalidRow] = []

    def __call__(self, row: pa.csv.InvalidRow) -> str:
        self.rows.append(row)
        return "skip"


def _parse(content: bytes, names: list[str], delimiter: str, wrong: _Collector | None = None) -> pa.Table:
    return pa.csv.read_csv(
        pa.BufferReader(content),
        read_options=pa.csv.ReadOptions(column_names=names, skip_rows=1, use_threads=wrong is None),
        parse_options=pa.csv.ParseOptions(delimiter=delimiter, invalid_row_handler=wrong),
        convert_options=pa.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
    )


def _first_bad_row(content: bytes, names: list[str], delimiter: str) -> str:
    """Which row has a wrong number of cells, counted from 1 after the header; empty if none has."""
    wrong = _Collector()
    try:
        _parse(content, names, delimiter, wrong)  # in one thread: only then are rows numbered
    except pa.ArrowInvalid as error:
        return "a line is longer than 1 MiB" if "straddl" in str(error) else ""
    if not wrong.rows:
        return ""
    row = wrong.rows[0]
    cells = f"has {row.actual_columns} cells and the header {row.expected_columns}"
    return f"row {row.number - 1} {cells}: {' '.join(row.text.split())[:_SHOWN]!r}"
