"""Read a text file of measurements with any delimiter, decimal mark, encoding and preamble, also gzipped."""

from __future__ import annotations

import codecs
import gzip
import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from palpate.estimation.data.arrow import pa, pa_csv, pc
from palpate.estimation.data.column_names import TIME, guess_columns
from palpate.estimation.data.file_columns import FileColumns, check_size, most_bytes
from palpate.estimation.data.quantity_words import FOREIGN_WORDS
from palpate.estimation.data.table_layout import matching_places, with_run
from palpate.estimation.data.text_dialect import (
    BLANKS,
    DELIMITERS,
    Block,
    TextDialect,
    TextTable,
    blanks_as_tabs,
    find_dialect,
    is_footer,
    is_number,
    line_cells,
    preamble_words,
    same_columns,
)
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import IntArray

_LONGEST_LINE = 2**20 - 1  # bytes; the reader uses blocks of 1 MiB, each of which must contain a line end
_MOST_COLUMNS = 20_000  # limits computing time, since each name is compared with all words for a quantity
_SHOWN = 60  # characters of a rejected line that an error message shows
_SYSTEMATIC = 0.25  # least share of short rows that are intentional; fewer are damaged rows


def read_text_table(path: Path, selected: str) -> FileColumns:
    """Read the columns of the longest table of a text file as text.

    Args:
        path: path of the file; gzipped if its name ends in .gz.
        selected: number of the header line of another table; empty for the longest table.

    Raises:
        InputError: the file is too large, is not text, has no header, or a row has a wrong number of cells.
    """
    open_file = gzip.open if path.name.lower().endswith(".gz") else open
    with open_file(path, "rb") as file:
        packed: bytes = file.read(most_bytes(path) + 1)
    check_size(path, len(packed))
    content, encoding = as_utf8(packed, path)
    if not content.strip():
        raise InputError(f"{path}: no rows of data; the file is empty")
    if content.count(b"\r") > content.count(b"\r\n"):  # line ends of old programs
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    first_lines = content.lstrip()[: _LONGEST_LINE + 1]
    if len(first_lines) > _LONGEST_LINE and b"\n" not in first_lines:
        raise InputError(f"{path}: its first line is longer than 1 MiB; put the names of the columns there")
    content = _labels_as_header(content)
    dialect = find_dialect(content)
    if dialect is None:  # names may have quoted line breaks, as spreadsheets write them
        content = _NAMES_IN_QUOTES.sub(_one_line, content[:_LOOKED_AT]) + content[_LOOKED_AT:]
        dialect = find_dialect(content) or _raise_no_table(content, path)
    if (columns := max(len(table.names) for table in dialect.tables)) > _MOST_COLUMNS:
        raise InputError(
            f"{path}: has {columns:,} columns, at most {_MOST_COLUMNS:,} are read; "
            "keep those of time, motion and effort"
        )
    if not content[dialect.tables[0].start :][:_LONGEST_LINE].strip():
        raise InputError(f"{path}: no rows of data")
    heads = [*(table.head for table in dialect.tables[1:]), len(content)]
    pairs = zip(dialect.tables, heads, strict=True)
    spans = [(table, table.start, _end_of_rows(content, table, end, dialect)) for table, end in pairs]
    below = [line for line in content[spans[-1][2] :].splitlines() if line.strip()]
    filled = [span for span in spans if span[2] > span[1]]
    if not filled:  # the parser then reports the error in these lines
        filled, below = [(dialect.tables[0], dialect.tables[0].start, len(content.rstrip()))], []
    blocks = []
    for table, begin, end in filled:
        line, rows = (1 + content.count(b"\n", *span) for span in ((0, table.head), (begin, end - 1)))
        blocks.append(Block(str(line), table.names, rows))
    chosen, note = same_columns(blocks, selected, path)
    tests = [filled[place] for place in chosen]
    lead = sum(bool(line.strip()) for line in content[: tests[0][0].head].splitlines())
    words = [*dialect.words, *(preamble_words(lead) if chosen[0] == 0 else []), *note]
    words += [f"a footer of {len(below)} line{'s' if len(below) > 1 else ''}"] if below else []
    words += [f"text in {encoding}"] if encoding else []
    places = [f"{path}, test {n}" if len(tests) > 1 else str(path) for n in range(1, len(tests) + 1)]
    read = [
        _parse_rows(content, begin, end, replace(dialect, tables=(table,)), place)
        for (table, begin, end), place in zip(tests, places, strict=True)
    ]
    parts, lines = [part for part, _, _ in read], [numbers for _, numbers, _ in read]
    words += dict.fromkeys(word for _, _, remarks in read for word in remarks)
    if len(parts) == 1:
        return FileColumns(parts[0], dialect.decimal, tuple(words), tests[0][0].titles, lines[0], "line")
    parts = [part.select(matching_places(part.column_names, parts[0].column_names)) for part in parts]
    if _is_one_recording(parts, dialect.decimal):
        words.append(f"{len(parts)} parts of one recording, whose times continue")
    else:
        parts = [with_run(part, str(number)) for number, part in enumerate(parts, 1)]
        words.append(f"{len(parts)} tests one after the other, read as runs")
    columns = pa.concat_tables(parts)
    return FileColumns(columns, dialect.decimal, tuple(words), (), np.concatenate(lines), "line")


def _labels_as_header(content: bytes) -> bytes:
    """Convert lines such as "Time: 12 ms, Force: 1.5 N" to a table; other text is unchanged.

    Names and units of the first such line become the header in the line above it. Lines with other labels
    become empty, so that line numbers are preserved, except if the first line is already a row.
    """
    lines = content.splitlines() if _PAIR.search(content[:_LOOKED_AT]) else []
    first = next((n for n, line in enumerate(lines[:_MOST_ABOVE]) if len(_PAIR.findall(line)) > 1), None)
    if first is None:
        return content
    labels = [(label, unit) for label, _, unit in _PAIR.findall(lines[first])]
    rows = list[bytes]()
    for line in lines[first:]:
        pairs, rest = _PAIR.findall(line), _PAIR.sub(b"", line).strip(b" ,;|\t")
        same_labels = not rest and [(label, unit) for label, _, unit in pairs] == labels
        rows.append(b",".join(number for _, number, _ in pairs) if same_labels else b"")
    if sum(map(bool, rows)) < max(_FEWEST_LABELLED, len(rows) / 2):
        return content
    names = b",".join(b"%b [%b]" % pair if pair[1] else pair[0] for pair in labels)
    return b"\n".join([*[b""] * (first - 1), names, *rows])


_NAMES_IN_QUOTES = re.compile(rb'(?:[^"\r\n]|"[^"]{0,1000}")+')  # one row with quoted line breaks


def _one_line(match: re.Match[bytes]) -> bytes:
    """Move quoted line breaks to the end of their row, so that later line numbers are preserved."""
    cells: bytes = match.group()
    return re.sub(rb"[ \t]*\r?\n[ \t]*", b" ", cells) + b"\n" * cells.count(b"\n")


def _is_one_recording(parts: Sequence[pa.Table], decimal: str) -> bool:
    """Return whether the clock continues from part to part, as on printed pages.

    Args:
        parts: columns of text with the same names.
        decimal: decimal mark.
    """
    clocks = [guess.column for guess in guess_columns(parts[0].column_names) if guess.key == TIME]
    if len(clocks) != 1:
        return False
    times = []
    for part in parts:
        cells = [str(part.column(clocks[0])[row].as_py()) for row in (0, 1, -1)] if len(part) > 1 else []
        times.append([number_of(cell.replace(decimal, ".")) for cell in cells])
    return all(
        len(before) == len(after) == 3
        and 0.0 < after[0] - before[2] <= _ONE_STEP * max(before[1] - before[0], after[1] - after[0])
        for before, after in pairwise(times)
    )


def _parse_rows(
    content: bytes, begin: int, end: int, dialect: TextDialect, place: str
) -> tuple[pa.Table, IntArray, list[str]]:
    """Parse the rows between two bytes without a copy; also return the line of each row, and notes."""
    rows = pa.py_buffer(content).slice(begin, end - begin)
    if dialect.delimiter == BLANKS:
        rows = pa.py_buffer(blanks_as_tabs(content[begin:end]))
    try:
        part = _parse(rows, dialect)
    except pa.ArrowInvalid as error:
        lines = _line_numbers(content, begin, end)
        mended = _repair_rows(rows.to_pybytes(), lines, dialect)
        with suppress(pa.ArrowInvalid):
            if mended and len(part := _parse(pa.py_buffer(mended[0]), dialect)) == len(mended[1]):
                return part, mended[1], mended[2]
        problem = " ".join(str(error).split())[:200]
        wrong: list[pa_csv.InvalidRow] = []
        try:
            _parse(rows, dialect, lambda row: wrong.append(row) or "skip")  # type: ignore[func-returns-value]
        except pa.ArrowInvalid as second:
            problem = "a line is longer than 1 MiB" if "straddl" in str(second) else problem
        else:
            if wrong:
                cells = f"has {wrong[0].actual_columns} cells and the header {wrong[0].expected_columns}"
                text = " ".join(wrong[0].text.split())[:_SHOWN]
                problem = f"line {lines[wrong[0].number - 1]} {cells}: {text!r}"
        raise InputError(f"{place}: {problem}") from error
    numbers = _line_numbers(content, begin, end, len(part))
    _check_quotes(part, numbers, dialect, place)
    return part, numbers, []


def _check_quotes(part: pa.Table, lines: IntArray, dialect: TextDialect, place: str) -> None:
    """Check that no quotation mark without a second one has swallowed rows of numbers.

    Args:
        part: parsed columns of text.
        lines: line number in the file of each row, shape (n,).
        dialect: dialect of the text.
        place: source of the rows, for the error message.

    Raises:
        InputError: a cell contains rows of numbers.
    """
    for column in part.columns:
        for row in np.flatnonzero(np.asarray(pc.match_substring(column, "\n").fill_null(False))):
            held = str(column[int(row)]).splitlines()[1:]
            cells = [line_cells(line, dialect.delimiter) for line in held]
            if any(len(row) >= part.num_columns and not is_footer(row, counts=True) for row in cells):
                raise InputError(
                    f"{place}: line {lines[row]}: a quotation mark opens a cell that holds {len(held)} more "
                    "lines, with numbers; close or remove it"
                )


def _repair_rows(
    rows: bytes, lines: IntArray, dialect: TextDialect
) -> tuple[bytes, IntArray, list[str]] | None:
    """Remove lines of words among the rows, and complete rows that end before the last column.

    Args:
        rows: text of the table.
        lines: line number in the file of each nonempty line, shape (n,).
        dialect: dialect of the text.

    Returns:
        The repaired text, the line number of each row, and notes; None if the rows cannot be repaired.
    """
    table, delimiter = dialect.tables[0], "\t" if dialect.delimiter == BLANKS else dialect.delimiter
    texts = [line for line in rows.decode(errors="replace").splitlines() if line.strip(" ")]
    if len(texts) != len(lines):
        return None
    cells = [line_cells(text, delimiter) for text in texts]
    decimal = dialect.decimal
    words = [table.counts and not is_number(row[0], decimal) and is_footer(row, counts=True) for row in cells]
    kept = np.flatnonzero(~np.array(words))
    lacking = [len(table.names) - len(cells[place]) for place in kept]
    short = np.flatnonzero(np.array(lacking) > 0)
    few = len(short) < _SYSTEMATIC * len(kept) or dialect.delimiter == BLANKS
    if not len(kept) or (len(short) and few):
        return None
    remarks = []
    if len(kept) < len(texts):
        count, first = len(texts) - len(kept), int(np.argmax(words))
        remarks.append(
            f"{count} line{'s' if count > 1 else ''} of text among the rows left out; the first is "
            f"line {lines[first]}: {' '.join(texts[first].split())[:_SHOWN]!r}"
        )
    if len(short):
        remarks.append(
            f"{len(short)} of {len(kept)} rows lack their last cells, which are read as empty; the "
            f"first is in line {lines[kept[short[0]]]}"
        )
    filled = (texts[place] + delimiter * max(lack, 0) for place, lack in zip(kept, lacking, strict=True))
    return "\n".join(filled).encode(), lines[kept], remarks


def _line_numbers(content: bytes, begin: int, end: int, count: int | None = None) -> IntArray:
    """Return the numbers of the nonempty lines in a part of a file; the first line of the file is 1.

    Args:
        content: content of the file.
        begin: index of the first byte.
        end: index after the last byte.
        count: number of rows read from these lines; None if each line is one row.
    """
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


def _raise_no_table(content: bytes, path: Path) -> TextDialect:
    """Raise the error that explains why no table was found."""
    line, *rest = content.lstrip().splitlines()
    header = line.decode(errors="replace")
    if not any(rest):
        raise InputError(f"{path}: no rows of data")
    cells = header.split(max(DELIMITERS, key=header.count))
    below = (line.decode(errors="replace") for line in rest if line.strip())
    if len(cells) == 1 and not any(math.isnan(number_of(cell)) for cell in below):
        raise InputError(
            f"{path}: holds only one column, {_excerpt(header)}; a measurement needs at least three: "
            "time, motion and effort"
        )
    first = next((line.decode(errors="replace") for line in rest if line.strip()), "")
    remedy = "write the names in one line, and numbers below each of them"
    if with_unit := _WITH_UNIT.search(first):
        remedy = f"write a unit in the name of its column, not behind numbers as in {with_unit[0]!r}"
    raise InputError(
        f"{path}: no line with the names of columns is followed by rows of numbers; it begins with "
        f"{_excerpt(header)}; {remedy}"
    )


def _excerpt(header: str) -> str:
    return repr(" ".join(header.split())[:_SHOWN])


def _parse(
    rows: pa.Buffer, dialect: TextDialect, skip: Callable[[pa_csv.InvalidRow], str] | None = None
) -> pa.Table:
    names = list(dialect.tables[0].names)
    delimiter = "\t" if dialect.delimiter == BLANKS else dialect.delimiter
    # Rows to skip are only numbered if the reader uses a single thread.
    return pa_csv.read_csv(
        pa.BufferReader(rows),
        read_options=pa_csv.ReadOptions(column_names=names, use_threads=skip is None),
        parse_options=pa_csv.ParseOptions(delimiter=delimiter, invalid_row_handler=skip),
        convert_options=pa_csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
    )


_PAIR = re.compile(  # a label, its number, and possibly a unit
    # The repetitions are bounded, since the search in a long cell would otherwise take quadratic time.
    rb"([A-Za-z\x80-\xff][\w \x80-\xff]{0,60}?)[ \t]{0,8}[:=][ \t]{0,8}([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
    rb"[ \t]?([A-Za-z\xb0-\xff%/]{0,5})(?=[\s,;|]|$)"
)
_MOST_ABOVE, _FEWEST_LABELLED = 100, 5  # most lines above labeled rows; least number of such rows


def _end_of_rows(content: bytes, table: TextTable, end: int, dialect: TextDialect) -> int:
    """Return the index of the byte after the last row of a table; lines before `end` may not be rows."""
    begin = table.start
    while end > begin:
        last = content.rfind(b"\n", begin, end - 1) + 1 or begin
        cells = line_cells(content[last:end].decode(errors="replace").strip("\r\n"), dialect.delimiter)
        if not is_footer(cells, counts=table.counts):
            break
        end = last
    return end


_MARKS = ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_ENCODINGS = ("cp1252", "gb18030", "cp932", "cp949", "cp1250", "cp1251")  # after UTF-8 and UTF-16
_ONE_STEP = 2.0  # largest interval between two parts of a recording, in steps of the clock
_WITH_UNIT = re.compile(r"(?<![\w.])[+-]?\d+(?:[.,]\d+)? ?[A-Za-zµ°%]{1,6}\b")  # a cell such as "0.5 mm"
_FEW_ZEROS = 1e-3  # largest share of zero bytes in a text
_CONTROLS = bytes(set(range(32)) - set(b"\t\n\r\f\x1a\x1b")) + b"\x7f\x81\x8d\x8f\x90\x9d"  # not in a text
_LOOKED_AT = 1 << 16  # bytes
_OTHERS = (  # first bytes of other file types, and the remedy
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
    testing machines use for degree signs and umlauts. A few zero bytes are ends of strings and are removed.

    Args:
        content: content of the file.
        path: path of the file, for error messages.

    Raises:
        InputError: the content is not text.
    """
    if content.startswith(codecs.BOM_UTF8):
        content = content[len(codecs.BOM_UTF8) :]
    encoding, head = (
        next((name for mark, name in _MARKS if content.startswith(mark)), ""),
        content[:_LOOKED_AT],
    )
    for name, zeros, letters in (("utf-16-le", head[1::2], head[::2]), ("utf-16-be", head[::2], head[1::2])):
        if len(head) >= 4 and not encoding and zeros.count(0) > 0.9 * len(zeros) and not letters.count(0):
            encoding = name
    if not encoding and content.count(b"\0") <= _FEW_ZEROS * len(content):
        content = content.replace(b"\0", b"")
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
    formats = (words for begins, words in _OTHERS if content.startswith(begins))
    return InputError(f"{path}: {next(formats, 'is not a text file; save it as CSV in UTF-8')}")
