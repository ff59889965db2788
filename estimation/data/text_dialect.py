"""How a text file of measurements is written: delimiter, decimal mark, and where its table begins."""

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from estimation.data.header_rows import (
    FEWEST_NUMBERS,
    NUMBER,
    Layout,
    find_layout,
    is_number,
    preamble_words,
)
from estimation.data.quantities import parse_role

DELIMITERS = (",", ";", "\t", "|")
BLANKS = " "  # one or more between cells
_LOOKED_AT = 1 << 18  # bytes
_MOST_LINES = 400
_BLANK = re.compile(r"\s+(?![\[(])")  # none between a name and its unit


@dataclass(frozen=True)
class Dialect:
    """How a text file is written."""

    delimiter: str  # between cells
    decimal: str  # mark in numbers
    names: tuple[str, ...]  # of the columns
    head: int  # byte at which the names begin
    start: int  # byte at which the first row of numbers begins
    skipped: int = 0  # lines before the names
    titles: tuple[str, ...] = ()  # cells of the row above the names

    @property
    def words(self) -> tuple[str, ...]:
        """What is not as in a plain CSV."""
        names = {";": "semicolons", "\t": "tabs", "|": "bars", BLANKS: "blanks"}
        found = [f"cells between {names[self.delimiter]}"] if self.delimiter in names else []
        found += ["decimal commas"] if self.decimal == "," else []
        return (*found, *preamble_words(self.skipped))


def find_dialect(content: bytes) -> Dialect | None:
    """How a UTF-8 text is written; None where no names are followed by numbers.

    A first line that holds one of palpate's own names is a header, whatever stands below it. Else every
    delimiter and decimal mark is tried, and that which makes the widest table wins.
    """
    lines = _lines(content)
    if not lines:
        return None
    first = max(DELIMITERS, key=lines[0][1].count)
    names = [" ".join(name.split()) for name in next(_cells([lines[0][1]], first), [])]
    if any(role and role.unit for role in map(parse_role, names)):
        rows = list(_cells([text for _, text in lines[1:]], first))
        decimal = "," if first != "," and commas_decide(rows) else "."
        named = tuple(name or f"column {number}" for number, name in enumerate(names, 1))
        end = re.compile(rb"\r\n|\r|\n|$").search(content, lines[0][0])
        return Dialect(first, decimal, named, lines[0][0], end.end() if end else len(content))
    tried = [found for found in _tried(lines) if found is not None]
    return max(tried, key=lambda found: len(found.names), default=None)


def blanks_as_tabs(content: bytes) -> bytes:
    """The text with each stretch of blanks between cells made one tab."""
    return re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", re.sub(rb"[ \t]+", b"\t", content))


def _tried(lines: list[tuple[int, str]]) -> Iterator[Dialect | None]:
    for delimiter in (*DELIMITERS, BLANKS):
        rows = list(_cells([text for _, text in lines], delimiter))
        decimal = "," if delimiter != "," and commas_decide(rows) else "."
        layout = find_layout(rows, decimal)
        if layout is not None:
            yield _dialect(lines, delimiter, decimal, _fitted(layout, rows[layout.first :]))


def is_footer(line: str, dialect: Dialect) -> bool:
    """Whether a line below the rows is none of them: empty, or words. A row that is cut off is one."""
    cells = [cell for cell in next(_cells([line], dialect.delimiter), []) if cell.strip()]
    numbers = [is_number(cell, dialect.decimal) for cell in cells]
    return not cells or (not numbers[0] and sum(numbers) < FEWEST_NUMBERS)


def _dialect(lines: list[tuple[int, str]], delimiter: str, decimal: str, layout: Layout) -> Dialect:
    skipped = sum(bool(text.strip()) for _, text in lines[: layout.header])
    head, start = (lines[row][0] for row in (layout.header, layout.first))
    return Dialect(delimiter, decimal, layout.names, head, start, skipped, layout.titles)


def _fitted(layout: Layout, body: list[list[str]]) -> Layout:
    """The layout with as many names as the rows have cells: both may end with the delimiter or a remark."""
    width, names = max(len(row) for row in body[:3]), list(layout.names)
    names += [f"column {number}" for number in range(len(names) + 1, width + 1)]
    return replace(layout, names=tuple(names[:width]))


def _lines(content: bytes) -> list[tuple[int, str]]:
    """Byte where each of the first lines begins, and its text; a last one that is cut off is left out."""
    head = content[:_LOOKED_AT]
    found: list[tuple[int, str]] = []
    for match in re.finditer(rb"[^\r\n]*(\r\n|\r|\n|$)", head):
        if len(found) == _MOST_LINES or (match.end() == len(head) < len(content) and found):
            break
        if match.group() or match.start() < len(head):
            found.append((match.start(), match.group().rstrip(b"\r\n").decode(errors="replace")))
    return found


def _cells(lines: list[str], delimiter: str) -> Iterator[list[str]]:
    if delimiter == BLANKS:
        yield from (_BLANK.split(line.strip(" \t#%")) for line in lines)
        return
    for line in lines:
        try:
            yield next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
        except csv.Error:  # a cell of more than 128 KiB
            yield [line]


def commas_decide(rows: list[list[str]]) -> bool:
    """Whether more numbers make sense with a decimal comma alone than with a decimal point alone.

    "1,234" may be either. Between other delimiters than commas it is taken for a little more than one.
    """
    marked = [cell for row in rows for cell in map(str.strip, row) if "," in cell or "." in cell]
    readings = [(bool(NUMBER[","].fullmatch(cell)), bool(NUMBER["."].fullmatch(cell))) for cell in marked]
    commas, points = readings.count((True, False)), readings.count((False, True))
    if commas == points == 0:
        return any(both == (True, True) and "," in cell for both, cell in zip(readings, marked, strict=True))
    return commas > points
