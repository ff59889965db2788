"""Read a text file of measurements with any delimiter, decimal mark, encoding and preamble, also gzipped."""

from __future__ import annotations

import codecs
import gzip
import itertools
import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.estimation.data.column_names import TIME, guess_columns
from palpate.estimation.data.file_columns import FileColumns, check_size, most_bytes, pa, pa_csv, pc
from palpate.estimation.data.quantity_words import FOREIGN_WORDS
from palpate.estimation.data.table_layout import matching_places, with_run
from palpate.estimation.data.text_dialect import (
    BLANKS,
    DELIMITERS,
    TableBlock,
    TextDialect,
    TextTable,
    are_signals,
    decimal_mark,
    find_dialect,
    is_footer,
    is_missing,
    is_number,
    line_cells,
    numbered_names,
    same_columns,
)
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import IntArray

_MAX_LINE_BYTES = 2**20 - 1  # bytes; the reader uses blocks of 1 MiB, each of which must contain a line end
_MAX_COLUMNS = 20_000  # limits computing time, since each name is compared with all words for a quantity
_SHOWN = 60  # characters of a rejected line that an error message shows
_MIN_NUMBERS = 3  # least number of rows of a file with one column
_ALIKE = 100  # first lines that decide on the decimal mark of a file with one column
_ALIGNED = "cells aligned in columns"
_SAME, _MAX_HEADER = 3, 3  # least number of aligned rows, and most lines of names and units above them
_SYSTEMATIC = 0.25  # least share of short rows that are intentional; fewer are damaged rows


def read_text_table(path: Path, selected: str) -> FileColumns:
    """Read the columns of the longest table of a text file as text.

    Args:
        path: path of the file; gzipped if its name ends in .gz.
        selected: number of the header line of another table; empty for the longest table.

    Raises:
        InputError: the file is too large, is not text, has no header, or a row has a wrong number of cells.
    """
    content, encoding = _read_text(path)
    columns_of_rows = _transposed(content)
    content = columns_of_rows or content
    content, dialect, is_aligned = _with_dialect(content)
    if dialect is None and (column := _only_column(content)) is not None:
        return column
    if dialect is None:  # names may have quoted line breaks, as spreadsheets write them
        # Line breaks move to the end of their row, so that later line numbers are preserved.
        joined = _NAMES_IN_QUOTES.sub(
            lambda cells: re.sub(rb"[ \t]*\r?\n[ \t]*", b" ", cells[0]) + b"\n" * cells[0].count(b"\n"),
            content[:_LOOKED_AT],
        )
        content = joined + content[_LOOKED_AT:]
        dialect = find_dialect(content) or _raise_no_table(content, path)
    if (columns := max(len(table.names) for table in dialect.tables)) > _MAX_COLUMNS:
        raise InputError(
            f"{path}: has {columns:,} columns, but at most {_MAX_COLUMNS:,} are read; keep the columns of "
            "time, motion and effort, or, if each row holds a signal, save the table transposed"
        )
    if not content[dialect.tables[0].start :][:_MAX_LINE_BYTES].strip():
        raise InputError(f"{path}: no rows of data")
    heads = [*(table.head for table in dialect.tables[1:]), len(content)]
    pairs = list(zip(dialect.tables, heads, strict=True))
    spans = [(table, _end_of_rows(content, table, end, dialect.delimiter)) for table, end in pairs]
    below = [line for line in content[spans[-1][1] :].splitlines() if line.strip()]
    footer = [line for line in below if line.strip(b'" \t' + dialect.delimiter.encode())]
    empty = len(below) - len(footer)
    filled = [(table, end) for table, end in spans if end > table.start]
    if not filled:  # the parser then reports the error in these lines
        filled, footer, empty = [(dialect.tables[0], len(content.rstrip()))], [], 0
    blocks = []
    for table, end in filled:
        line, rows = (1 + content.count(b"\n", *span) for span in ((0, table.head), (table.start, end - 1)))
        blocks.append(TableBlock(str(line), table.names, rows))
    chosen, note = same_columns(blocks, selected, path)
    tests = [block for place in chosen for block in _blocks(content, *filled[place], dialect.delimiter)]
    lead = content[: tests[0][0].head if chosen[0] == 0 else 0].decode(errors="replace").splitlines()
    preamble = tuple(line.strip() for line in lead if line.strip())
    notes = [] if columns_of_rows else [_ALIGNED] if is_aligned else [*dialect.notes]
    notes += note
    notes += [f"a footer of {len(footer)} line{'s' if len(footer) > 1 else ''}"] if footer else []
    notes += [f"{empty} empty row{'s' if empty > 1 else ''} at the end left out"] if empty else []
    notes += [f"text in {encoding}"] if encoding else []
    parts, lines, repairs = [], [], dict[str, None]()
    for number, (table, end) in enumerate(tests, 1):
        place = f"{path}, test {number}" if len(tests) > 1 else str(path)
        part, part_lines, part_repairs = _parse_rows(content, table, end, dialect, place)
        parts.append(part.select(matching_places(table.names, tests[0][0].names)))
        lines.append(part_lines)
        repairs |= dict.fromkeys(part_repairs)
    notes += repairs
    titles = tests[0][0].titles if len(parts) == 1 else ()
    if len(parts) > 1 and (clock := _continued_clock(parts, dialect.decimal)):
        notes.append(f"{len(parts)} parts are read as one recording, because '{clock}' continues")
    elif len(parts) > 1:
        parts = [with_run(part, str(number)) for number, part in enumerate(parts, 1)]
        notes.append(f"{len(parts)} tests one after the other, read as runs")
    numbers = np.concatenate(lines)
    row_word = "column" if columns_of_rows else "line"
    return FileColumns(
        pa.concat_tables(parts), dialect.decimal, tuple(notes), titles, numbers, row_word, preamble
    )


def _with_dialect(content: bytes) -> tuple[bytes, TextDialect | None, bool]:
    """Return a text that can be split into cells, its dialect, and whether its cells were aligned."""
    dialect = find_dialect(content)
    sample = content[: content.rfind(b"\n", 0, _LOOKED_AT)]
    if (dialect is None or dialect.delimiter == BLANKS) and _aligned(sample):
        tabbed = _aligned(content)
        if of_tabs := find_dialect(tabbed):
            return tabbed, of_tabs, True
    return content, dialect, False


def _transposed(content: bytes) -> bytes:
    """Return a text whose rows hold one signal each with its columns as lines; empty for other text."""
    first, lines = content.lstrip().partition(b"\n")[0], list[str]()
    for delimiter in DELIMITERS:
        if first.count(delimiter.encode()) > content.count(b"\n"):  # unlike most files
            lines = lines or content.decode(errors="replace").splitlines()
            split = (line_cells(line, delimiter) for line in lines if line.strip())
            rows = [[" ".join(cell.split()) for cell in cells] for cells in split]
            if are_signals(rows, decimal_mark(rows, in_doubt=delimiter != ",")):
                return "\n".join(map("\t".join, itertools.zip_longest(*rows, fillvalue=""))).encode()
    return b""


def _aligned(content: bytes) -> bytes:
    """Return a text whose cells stand in columns of characters, some empty, with tabs between the cells.

    The result is empty for other text, and if each line may as well be split at blanks.
    """
    lines = [line.rstrip() for line in content.decode(errors="replace").split("\n")]
    is_row = [_ROW_OF_NUMBERS.fullmatch(line) is not None for line in lines]
    first = next((n for n in range(1, len(lines)) if all(is_row[n : n + _SAME])), len(lines))
    last = next((n for n in range(first, len(lines)) if not is_row[n]), len(lines))
    if last - first < _SAME:
        return b""
    columns = list[list[int]]()  # first and last character of each
    for begin, end in sorted({m.span() for line in lines[first:last] for m in re.finditer(r"\S+", line)}):
        if columns and begin <= columns[-1][1]:
            columns[-1][1] = max(end, columns[-1][1])
        else:
            columns.append([begin, end])
    between = list(itertools.pairwise(columns))

    def split(line: str) -> list[str]:
        """Return the cells of a line, none if a cell of it reaches into two columns."""
        cuts = [line.ljust(columns[-1][1]).find(" ", left[1], right[0]) for left, right in between]
        cells = [line[begin:end].strip() for begin, end in itertools.pairwise([0, *cuts, None])]
        return [] if -1 in cuts or any("  " in cell for cell in cells) else cells

    counts = {len(line.split()) for line in lines[first:last]}
    header = list(itertools.takewhile(bool, map(split, reversed(lines[max(first - _MAX_HEADER, 0) : first]))))
    while header and not all(header[-1]):
        header.pop()
    top = first - len(header)
    counts |= {len(line_cells(line, BLANKS)) for line in lines[top:first]}
    if not header or len(columns) != max(counts & {len(columns)}, default=0) or len(counts) == 1:
        return b""
    lines[top:last] = map("\t".join, map(split, lines[top:last]))
    return "\n".join(lines).encode()


def is_prose(path: Path) -> bool:
    """Return whether a short .txt file, as a readme, has no table and no line that begins with a number."""
    if path.suffix.lower() != ".txt" or path.stat().st_size > _LOOKED_AT:
        return False
    with suppress(InputError):
        content, _ = _read_text(path)
        return not re.search(rb"(?m)^[^\w\n]*\d", content) and find_dialect(content) is None
    return False


def _read_text(path: Path) -> tuple[bytes, str]:
    """Return the text of a file as UTF-8 without old line ends, and its encoding if it was another one."""
    open_file = gzip.open if path.name.lower().endswith(".gz") else open
    with open_file(path, "rb") as file:
        packed: bytes = file.read(most_bytes(path) + 1)
    check_size(path, len(packed))
    content, encoding = as_utf8(packed, path)
    if not content.strip():
        raise InputError(f"{path}: no rows of data; the file is empty")
    if content.count(b"\r") > content.count(b"\r\n"):  # line ends of old programs
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    content = re.sub(rb"\xe2\x88\x92(?<![0-9A-DF-Za-df-z]\xe2\x88\x92)(?=[\d.])", b"-", content)
    for mark in (b"'", b"\xe2\x80\x99"):  # in "1'000"
        content = re.sub(mark + rb"(?<=\d" + mark + rb")(?=\d{3}(?!\d))", b"", content)
    if 0 < content.count(b";") == len(_ROW_END.findall(content)):  # it only ends rows
        content = _ROW_END.sub(b"", content)
    if _FORTRAN.search(content[:_LOOKED_AT]):
        content = re.sub(rb"[dD](?<=[\d.]{2}[dD])(?=[-+]\d\d)", b"e", content)
    first_lines = content.lstrip()[: _MAX_LINE_BYTES + 1]
    if len(first_lines) > _MAX_LINE_BYTES and b"\n" not in first_lines:
        raise InputError(f"{path}: its first line is longer than 1 MiB; put the names of the columns there")
    return content, encoding


_ROW_OF_NUMBERS = re.compile(r" *[-+.\d][-+.,\deE]*(?: +[-+.\d][-+.,\deE]*)+")
_ROW_END = re.compile(rb";(?=[ \t]*\r?(?:\n|$))")
_FORTRAN = re.compile(rb"\d\.\d*[dD][-+]\d\d")  # a number of double precision, such as "1.5D+03"
_NAMES_IN_QUOTES = re.compile(rb'(?:[^"\r\n]|"[^"]{0,1000}")+')  # one row with quoted line breaks


def _blocks(content: bytes, table: TextTable, end: int, delimiter: str) -> list[tuple[TextTable, int]]:
    """Return the blocks of rows, each with its end, into which lines of comments divide a table."""
    edges = [table.start]
    for match in _COMMENT_LINE.finditer(content, max(table.start - 1, 0), end):
        cells = line_cells(match.group().decode(errors="replace").strip(), delimiter)
        # "#N/A" is a missing value, and a first column of words may contain "#1".
        if cells and not is_missing(cells[0]) and (table.counts or len(cells) < len(table.names)):
            edges += [match.start() + 1, min(match.end() + 1, end)]
    pairs = zip(edges[::2], [*edges[1::2], end], strict=True)
    filled = [(replace(table, start=start), stop) for start, stop in pairs if content[start:stop].strip()]
    return filled or [(table, end)]


_COMMENT_LINE = re.compile(rb"\n[ \t]*(?:[#%!]|//)[^\n]*")


def _continued_clock(parts: Sequence[pa.Table], decimal: str) -> str:
    """Return the clock that continues from part to part, as in a table split into pages; empty for none."""
    clocks = [guess.column for guess in guess_columns(parts[0].column_names) if guess.key == TIME]
    if len(clocks) != 1 or not all(map(len, parts)):
        return ""
    ends = []
    for part in parts:
        cells = (str(part.column(clocks[0])[row].as_py()) for row in (0, max(-2, -len(part)), -1))
        ends.append([number_of(cell.replace(decimal, ".")) for cell in cells])
    first, last_but_one, last = np.array(ends).T
    gaps, steps = first[1:] - last[:-1], last - last_but_one
    steps = np.where(steps > 0.0, steps, steps.max())  # one row between comments has no step
    return clocks[0] if ((gaps > 0.0) & (gaps <= _ONE_STEP * steps[:-1])).all() else ""


def _parse_rows(
    content: bytes, table: TextTable, end: int, dialect: TextDialect, place: str
) -> tuple[pa.Table, IntArray, list[str]]:
    """Parse the rows of a table without a copy; also return the line of each row, and notes on repairs."""
    rows, delimiter = pa.py_buffer(content).slice(table.start, end - table.start), dialect.delimiter
    if delimiter == BLANKS:
        tabbed = re.sub(rb"[ \t]+", b"\t", content[table.start : end])  # one tab for each stretch of blanks
        rows, delimiter = pa.py_buffer(re.sub(rb"(?m)^\t|\t(?=\r?$)", b"", tabbed)), "\t"
    try:
        part = _parse(rows, table.names, delimiter)
    except pa.ArrowInvalid as error:
        lines = _line_numbers(content, table.start, end)
        completed = _completed_rows(rows.to_pybytes(), lines, table, dialect.delimiter)
        with suppress(pa.ArrowInvalid):
            if completed and len(part := _parse(completed[0], table.names, delimiter)) == len(lines):
                return part, lines, completed[1]
        problem = " ".join(str(error).split())[:200]
        invalid: list[pa_csv.InvalidRow] = []
        try:
            _parse(rows, table.names, delimiter, lambda row: invalid.append(row) or "skip")  # type: ignore[func-returns-value]
        except pa.ArrowInvalid as parse_error:
            problem = "a line is longer than 1 MiB" if "straddl" in str(parse_error) else problem
        if invalid:
            number, expected = invalid[0].actual_columns, invalid[0].expected_columns
            cells = f"{number} {'cell' if number == 1 else 'cells'}"
            text = " ".join(invalid[0].text.split())[:_SHOWN]
            line = lines[invalid[0].number - 1]
            problem = (
                f"line {line} has {cells}, but the header has {expected}: {text!r}; correct or remove this "
                "line"
            )
        raise InputError(f"{place}: {problem}") from error
    lines = _line_numbers(content, table.start, end, len(part))
    # A quotation mark without a second one may have swallowed rows of numbers.
    for column in part.columns:
        for row in np.flatnonzero(np.asarray(pc.match_substring(column, "\n").fill_null(False))):
            inside = [line_cells(line, dialect.delimiter) for line in str(column[int(row)]).splitlines()[1:]]
            if any(len(cells) >= part.num_columns and not is_footer(cells, counts=True) for cells in inside):
                raise InputError(
                    f"{place}: line {lines[row]}: a quotation mark opens a cell that holds {len(inside)} "
                    "more lines, with numbers; close the quotation, or remove the mark"
                )
    return part, lines, []


def _completed_rows(
    rows: bytes, lines: IntArray, table: TextTable, delimiter: str
) -> tuple[pa.Buffer, list[str]] | None:
    """Complete rows that end before the last column, with a note; None for few rows, which are damaged."""
    texts = [line for line in rows.decode(errors="replace").splitlines() if line.strip(" ")]
    lacking = np.array([len(table.names) - len(line_cells(text, delimiter)) for text in texts])
    short = np.flatnonzero(lacking > 0)
    few = delimiter == BLANKS or len(short) < _SYSTEMATIC * len(texts)
    if len(texts) != len(lines) or (len(short) and few):
        return None
    notes = []
    if len(short):
        notes.append(
            f"{len(short)} of {len(texts)} rows lack their last cells, which are read as empty; the first is "
            f"in line {lines[short[0]]}"
        )
    completed = (text + delimiter * max(lack, 0) for text, lack in zip(texts, lacking.tolist(), strict=True))
    return pa.py_buffer("\n".join(completed).encode()), notes


def _line_numbers(content: bytes, begin: int, end: int, count: int | None = None) -> IntArray:
    """Return the line numbers of `count` rows in a part of a file; None if each nonempty line is a row."""
    first = 1 + content.count(b"\n", 0, begin)
    if count is not None and count >= content.count(b"\n", begin, end):  # no line is empty
        return np.arange(first, first + count)
    lines = content[begin:end].split(b"\n")
    filled = first + np.flatnonzero([bool(line.strip(b" \r")) for line in lines])
    # If quoted cells contain line ends, there are more lines than rows.
    return filled if count is None or count == len(filled) else np.arange(first, first + count)


def number_of(text: object) -> float:
    """Convert a cell to a number; NaN if it is not a number.

    Args:
        text: text of a cell, with a decimal point.
    """
    written = str(text).strip()
    try:
        return math.nan if "_" in written else float(written)
    except ValueError:
        return math.nan


def _only_column(content: bytes) -> FileColumns | None:
    """Read lines with one number each, perhaps below a name, as a part of a measurement; or None."""
    lines = [line.strip() for line in content.decode(errors="replace").splitlines()]
    filled = [number for number, line in enumerate(lines) if line]
    decimal = "," if any("," in lines[n] for n in filled[1:_ALIKE]) else "."
    header = [] if is_number(lines[filled[0]], decimal) else [lines[filled.pop(0)]]
    if len(filled) < _MIN_NUMBERS or not all(is_number(lines[number], decimal) for number in filled):
        return None
    name = header[0].strip('"') if header else numbered_names(1)[0]
    column = pa.table({name: pa.array([lines[number] for number in filled])})
    return FileColumns(column, decimal, rows=1 + np.array(filled), row_word="line")


def _raise_no_table(content: bytes, path: Path) -> TextDialect:
    """Raise the error that explains why no table was found."""
    line, *rest = content.lstrip().splitlines()
    if not any(rest):
        raise InputError(f"{path}: no rows of data")
    first = next((line.decode(errors="replace") for line in rest if line.strip()), "")
    remedy = "write the column names in one line, with numbers below each name"
    if with_unit := _WITH_UNIT.search(first):
        remedy = f"write a unit in the name of its column, not behind numbers as in {with_unit[0]!r}"
    texts = (" ".join(text.split())[:_SHOWN] for text in (line.decode(errors="replace"), first))
    begin = ", then ".join(repr(text) for text in texts if text)
    raise InputError(
        f"{path}: no line of column names above rows of numbers was found; the file begins with {begin}; "
        f"{remedy}; if the file is not a measurement, leave it out"
    )


def _parse(
    rows: pa.Buffer,
    names: Sequence[str],
    delimiter: str,
    skip: Callable[[pa_csv.InvalidRow], str] | None = None,
) -> pa.Table:
    # Rows to skip are only numbered if the reader uses a single thread.
    return pa_csv.read_csv(
        pa.BufferReader(rows),
        read_options=pa_csv.ReadOptions(column_names=list(names), use_threads=skip is None),
        parse_options=pa_csv.ParseOptions(delimiter=delimiter, invalid_row_handler=skip),
        convert_options=pa_csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
    )


def _end_of_rows(content: bytes, table: TextTable, end: int, delimiter: str) -> int:
    """Return the index of the byte after the last row of a table; lines before `end` may not be rows."""
    begin = table.start
    while end > begin:
        last = content.rfind(b"\n", begin, end - 1) + 1 or begin
        cells = line_cells(content[last:end].decode(errors="replace").strip("\r\n"), delimiter)
        if not is_footer(cells, counts=table.counts):
            break
        end = last
    return end


_ENCODINGS = ("cp1252", "gb18030", "cp932", "cp949", "cp1250", "cp1251")  # after UTF-8 and UTF-16
_ONE_STEP = 2.0  # largest interval between two parts of a recording, in steps of the clock
_WITH_UNIT = re.compile(r"(?<![\w.])[+-]?\d+(?:[.,]\d+)? ?[A-Za-zµ°%]{1,6}\b")  # a cell such as "0.5 mm"
_FEW_ZEROS = 1e-3  # largest share of zero bytes in a text
_LOST_IN_NUMBER = re.compile(rb"(?<=[\d.])\0+|\0+(?=[-+\d.])")  # zero bytes that stand for lost characters
_CONTROLS = bytes(set(range(32)) - set(b"\t\n\r\f\x1a\x1b")) + b"\x7f\x81\x8d\x8f\x90\x9d"  # not in a text
_LOOKED_AT = 1 << 16  # bytes
_OTHER_FORMATS = (  # first bytes of other file types, and the remedy
    (b"\x89PNG", "is a picture; save the measurements themselves"),
    (b"\xff\xd8\xff", "is a picture; save the measurements themselves"),
    (b"%PDF", "is a PDF; save the measurements themselves"),
    (b"PK\x03\x04", "is a packed archive, perhaps a workbook: rename it to end in .xlsx or .npz"),
    (b"\x1f\x8b", "is compressed: rename it to end in .gz"),
    (b"PAR1", "is a Parquet file: rename it to end in .parquet"),
)


def as_utf8(content: bytes, path: Path) -> tuple[bytes, str]:
    """Convert a text to UTF-8 without byte order mark, and return its encoding if it was not UTF-8.

    UTF-16 is recognized by its byte order mark, or by zero bytes between Latin letters. For other text that
    is not UTF-8, the encoding is the first one in which the text contains a known word, such as the Chinese
    word for force. Otherwise, text without control characters is read as Western European (cp1252), which
    testing machines use for degree signs and umlauts. A few zero bytes are ends of strings and are removed;
    next to a digit they are lost characters of a number, and become U+FFFD, which no number contains.

    Args:
        content: content of the file.
        path: path of the file, for error messages.

    Raises:
        InputError: the content is not text.
    """
    if content.startswith(codecs.BOM_UTF8):
        content = content[len(codecs.BOM_UTF8) :]
    head = content[:_LOOKED_AT]
    encoding = "utf-16" if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else ""
    for name, zeros, letters in (("utf-16-le", head[1::2], head[::2]), ("utf-16-be", head[::2], head[1::2])):
        if len(head) >= 4 and not encoding and zeros.count(0) > 0.9 * len(zeros) and not letters.count(0):
            encoding = name
    if not encoding and content.count(b"\0") <= _FEW_ZEROS * len(content):
        content = _LOST_IN_NUMBER.sub("\ufffd".encode(), content).replace(b"\0", b"")
    try:
        if encoding:
            return content.decode(encoding).encode(), encoding
        if not content.isascii():
            content.decode()
    except UnicodeDecodeError:
        if encoding:
            raise _no_text(content, path) from None
        head = content[:_LOOKED_AT]  # the last character may be truncated
        texts = {name: codecs.getincrementaldecoder(name)("replace").decode(head) for name in _ENCODINGS}
        texts = {name: text.lower() for name, text in texts.items() if "�" not in text}
        known = (name for name, text in texts.items() if any(word in text for word in FOREIGN_WORDS))
        encoding = next(known, "cp1252")
        if encoding == "cp1252" and any(byte in _CONTROLS for byte in head):
            raise _no_text(content, path) from None
        return content.decode(encoding, errors="replace").encode(), encoding
    if b"\0" in content:
        raise _no_text(content, path)
    return content, ""


def _no_text(content: bytes, path: Path) -> InputError:
    formats = (words for begins, words in _OTHER_FORMATS if content.startswith(begins))
    return InputError(f"{path}: {next(formats, 'is not a text file; save it as CSV in UTF-8')}")
