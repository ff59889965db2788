"""Read a text file of measurements with any delimiter, decimal mark, encoding and preamble, packed or not."""

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

from palpate.estimation.data.arrow import pa, pa_csv
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

_LONGEST_LINE = 2**20 - 1  # bytes; the reader takes blocks of 1 MiB, and the line must end in one
_MOST_COLUMNS = 20_000  # each name is compared with all words for a quantity
_SHOWN = 60  # characters of a line that is refused
_SYSTEMATIC = 0.25  # share of rows that may end before the last column; fewer are damaged


def read_text_table(path: Path, selected: str) -> FileColumns:
    """Read the columns of a text file as text, by the names above the rows of its longest table.

    Args:
        path: path of the file; packed if its name ends in .gz.
        selected: line at which another table's header begins; empty for the longest table.

    Raises:
        InputError: it is too large, is no text, has no header, or a row has too few or too many cells.
    """
    open_file = gzip.open if path.name.lower().endswith(".gz") else open
    with open_file(path, "rb") as file:
        packed: bytes = file.read(most_bytes(path) + 1)
    check_size(path, len(packed))
    content, encoding = as_utf8(packed, path)
    if not content.strip():
        raise InputError(f"{path}: no rows of data; the file is empty")
    first_lines = content.lstrip()[: _LONGEST_LINE + 1]
    if len(first_lines) > _LONGEST_LINE and not any(end in first_lines for end in _ENDS):
        raise InputError(f"{path}: its first line is longer than 1 MiB; put the names of the columns there")
    content = _labels_as_header(content)
    dialect = find_dialect(content)
    if dialect is None:  # perhaps because names have line breaks in quotes, as a spreadsheet writes them
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
    if not filled:  # then a reader can say best what is wrong with these lines
        filled, below = [(dialect.tables[0], dialect.tables[0].start, len(content))], []
    blocks = []
    for table, begin, end in filled:
        line, rows = 1 + _line_ends(content, 0, table.head), 1 + _line_ends(content, begin, end - 1)
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
        words.append(f"{len(parts)} parts of one recording, whose time goes on")
    else:
        parts = [with_run(part, str(number)) for number, part in enumerate(parts, 1)]
        words.append(f"{len(parts)} tests one after the other, taken as runs")
    columns = pa.concat_tables(parts)
    return FileColumns(columns, dialect.decimal, tuple(words), (), np.concatenate(lines), "line")


def _labels_as_header(content: bytes) -> bytes:
    """Convert lines such as "Time: 12 ms, Force: 1.5 N" to a table; other text is unchanged.

    Names and units of the first such line become the header in the line above. Lines with other labels become
    empty, so that line numbers stay, except if the first line is already a row.
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


_NAMES_IN_QUOTES = re.compile(rb'(?:[^"\r\n]|"[^"]{0,1000}")+')  # one line of cells, with breaks in quotes


def _one_line(match: re.Match[bytes]) -> bytes:
    """Move line breaks inside quotes behind their line, so that the numbers of the lines below it stay."""
    cells: bytes = match.group()
    return re.sub(rb"[ \t]*\r?\n[ \t]*", b" ", cells) + b"\n" * cells.count(b"\n")


def _is_one_recording(parts: Sequence[pa.Table], decimal: str) -> bool:
    """Return whether the clock continues from part to part, as on printed pages.

    Args:
        parts: columns of text with the same names.
        decimal: mark in numbers.
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
    """Parse the rows between two bytes without a copy; also return the line of each row, and remarks."""
    rows = pa.py_buffer(content).slice(begin, end - begin)
    if dialect.delimiter == BLANKS:
        rows = pa.py_buffer(blanks_as_tabs(content[begin:end]))
    try:
        part = _parse(rows, dialect)
        return part, _line_numbers(content, begin, end, len(part)), []
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


def _repair_rows(
    rows: bytes, lines: IntArray, dialect: TextDialect
) -> tuple[bytes, IntArray, list[str]] | None:
    """Remove lines of words among the rows, and complete rows that end before the last column.

    Args:
        rows: text of the table.
        lines: number in the file of each line that is not empty, shape (n,).
        dialect: dialect of the text.

    Returns:
        The text, the number of each row's line, and remarks; None where nothing can be mended.
    """
    table, delimiter = dialect.tables[0], "\t" if dialect.delimiter == BLANKS else dialect.delimiter
    texts = [line for line in rows.decode(errors="replace").splitlines() if line.strip(" ")]
    if len(texts) != len(lines):
        return None
    cells = [line_cells(text, delimiter) for text in texts]
    decimal = dialect.decimal
    words = [
        table.counts and not is_number(row[0], decimal) and is_footer(row, decimal, counts=True)
        for row in cells
    ]
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
            f"{count} line{'s' if count > 1 else ''} of words among the rows left out, the first is line "
            f"{lines[first]}: {' '.join(texts[first].split())[:_SHOWN]!r}"
        )
    if len(short):
        remarks.append(
            f"{len(short)} of {len(kept)} rows end before the last column, the first in line "
            f"{lines[kept[short[0]]]}: its cells count as empty"
        )
    filled = (texts[place] + delimiter * max(lack, 0) for place, lack in zip(kept, lacking, strict=True))
    return "\n".join(filled).encode(), lines[kept], remarks


def _line_numbers(content: bytes, begin: int, end: int, count: int | None = None) -> IntArray:
    """Return the line numbers, from 1, of the lines between two bytes that are not empty.

    Args:
        content: content of the file.
        begin: first byte.
        end: byte after the last.
        count: how many rows were read of them; None for as many as there are lines.
    """
    mark = b"\n" if b"\n" in content else b"\r"
    first = 1 + _line_ends(content, 0, begin)
    if count is not None and count >= content.count(mark, begin, end):  # no line is empty
        return np.arange(first, first + count)
    lines = content[begin:end].split(mark)
    filled = first + np.flatnonzero([bool(line.strip(b" \r")) for line in lines])
    # Where a cell in quotation marks holds the end of a line, lines are more than rows.
    return filled if count is None or count == len(filled) else np.arange(first, first + count)


def _line_ends(content: bytes, begin: int, end: int) -> int:
    return content.count(b"\n" if b"\n" in content else b"\r", begin, end)


def number_of(text: object) -> float:
    """Convert a cell to a number; NaN if it holds none.

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
            f"{path}: holds one column, {_excerpt(header)}; a measurement needs time and two more"
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
    # In one thread where rows may be skipped: only then are they numbered.
    return pa_csv.read_csv(
        pa.BufferReader(rows),
        read_options=pa_csv.ReadOptions(column_names=names, use_threads=skip is None),
        parse_options=pa_csv.ParseOptions(delimiter=delimiter, invalid_row_handler=skip),
        convert_options=pa_csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
    )


_PAIR = re.compile(  # a label, its number, and perhaps a unit
    # Bounded, or a long cell would be searched from each of its letters to its end.
    rb"([A-Za-z\x80-\xff][\w \x80-\xff]{0,60}?)[ \t]{0,8}[:=][ \t]{0,8}([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
    rb"[ \t]?([A-Za-z\xb0-\xff%/]{0,5})(?=[\s,;|]|$)"
)
_MOST_ABOVE, _FEWEST_LABELLED = 100, 5  # lines above such rows; rows
_ENDS = (b"\n", b"\r")


def _end_of_rows(content: bytes, table: TextTable, end: int, dialect: TextDialect) -> int:
    """Byte after the last row of a table, without the lines before `end` that are no rows."""
    begin = table.start
    ends = dict.fromkeys(_ENDS, end)  # where each was met last, so that every byte is looked at once
    while end > begin:
        line = end - (2 if content.endswith(b"\r\n", begin, end) else 1)
        ends |= {mark: content.rfind(mark, begin, line) for mark, place in ends.items() if place >= line}
        last = max(begin, *(place + 1 for place in ends.values()))
        cells = line_cells(content[last:end].decode(errors="replace").strip("\r\n"), dialect.delimiter)
        if not is_footer(cells, dialect.decimal, counts=table.counts):
            break
        end = last
    return end


_MARKS = ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_ENCODINGS = ("cp1252", "gb18030", "cp932", "cp949", "cp1250", "cp1251")  # after UTF-8 and UTF-16
_ONE_STEP = 2.0  # steps of a clock from one part of a recording to the next, at most
_WITH_UNIT = re.compile(r"(?<![\w.])[+-]?\d+(?:[.,]\d+)? ?[A-Za-zµ°%]{1,6}\b")  # a cell such as "0.5 mm"
_FEW_ZEROS = 1e-3  # largest share of zero bytes in a text
_CONTROLS = bytes(set(range(32)) - set(b"\t\n\r\f\x1a\x1b")) + b"\x7f\x81\x8d\x8f\x90\x9d"  # none in a text
_LOOKED_AT = 1 << 16  # bytes
_OTHERS = (  # how files begin that are called text by mistake, and what to do with them
    (b"\x89PNG", "is a picture; save the measurements themselves"),
    (b"\xff\xd8\xff", "is a picture; save the measurements themselves"),
    (b"%PDF", "is a PDF; save the measurements themselves"),
    (b"PK\x03\x04", "is a packed archive, perhaps a workbook: let its name end in .xlsx or .npz"),
    (b"\x1f\x8b", "is packed: let its name end in .gz"),
    (b"PAR1", "is a Parquet file: let its name end in .parquet"),
)


def as_utf8(content: bytes, path: Path) -> tuple[bytes, str]:
    """Convert a text to UTF-8 without byte order mark, and name its encoding if it was another.

    UTF-16 is recognised by its byte order mark, or by zeros between Latin letters. For other text that is not
    UTF-8, the encoding is the first in which it contains a known word, such as the Chinese word for force;
    otherwise, without control characters, Windows' Western European (cp1252), in which testing machines write
    degree signs and umlauts. A few zeros are ends of strings and are removed.

    Args:
        content: content of the file.
        path: path of the file, for errors.

    Raises:
        InputError: it is no text.
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
        head = content[:_LOOKED_AT]  # the last character may be cut off
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
