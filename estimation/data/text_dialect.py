"""How text is written as a table: separator, decimal mark, and header rows."""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from palpate.estimation.data.column_names import parse_role
from palpate.estimation.data.units import dimension_of, normalise

NUMBER = {  # by the decimal mark; thousands may be grouped by the other one
    ".": re.compile(
        r"[+-]?(\d+(\.\d*)?|[1-9]\d{0,2}(,\d{3})+(\.\d*)?|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE
    ),
    ",": re.compile(
        r"[+-]?(\d+(,\d*)?|[1-9]\d{0,2}(\.\d{3})+(,\d*)?|,\d+)(e[+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE
    ),
}
_ALIKE = 3  # lines in a row that make a table
FEWEST_NUMBERS = 2  # in such a line
_COMMENT = "#%/;! \ufeff"
_LABVIEW = ("X_Value", "Y_Unit_Label", "X_Dimension")
_BRACKETS = "[](){}<>"


@dataclass(frozen=True)
class Layout:
    """Where what stands among rows of cells."""

    names: tuple[str, ...]  # of the columns, with the units of a row of units in brackets
    first: int  # index of the first row of numbers
    header: int  # index of the row of names
    titles: tuple[str, ...] = ()  # the row above the names


def find_layout(rows: Sequence[Sequence[str]], decimal: str) -> Layout | None:
    """Where the table begins; None where no row of names is followed by rows of numbers.

    Args:
        rows: cells of the first rows, as text.
        decimal: mark in numbers.
    """
    numeric = [_numbers(row, decimal) for row in rows]
    for first in range(1, len(rows)):
        width = max(len(_used(row)) for row in rows[first : first + _ALIKE])
        if sum(numeric[first]) < FEWEST_NUMBERS or not _goes_on(rows, decimal, first):
            continue
        header = _row_above(rows, first, width)
        if header is None or sum(numeric[header]) > 0:
            continue
        units = _units(rows[header], width) if header > 0 else None
        if units is None:
            return Layout(_names(rows, header, width), first, header, _titles(rows, header))
        above = _row_above(rows, header, width)
        if above is not None and not any(numeric[above]):
            plain = zip(_clean(rows[above], width), units, strict=True)
            names = tuple(f"{name} [{unit}]" if unit else name for name, unit in plain)
            return Layout(names, first, above, _titles(rows, above))
    return None


def preamble_words(lines: int) -> tuple[str, ...]:
    """A word on the lines before the names, if there are any.

    Args:
        lines: how many there are.
    """
    return (f"a preamble of {lines} line{'s' if lines > 1 else ''}",) if lines else ()


def _goes_on(rows: Sequence[Sequence[str]], decimal: str, first: int) -> bool:
    """Whether numbers stand in the same columns for some rows, or to the end; cells may be empty."""
    kinds: dict[int, bool] = {}
    for row in rows[first : first + _ALIKE]:
        if sum(map(bool, row)) > 0 and sum(_numbers(row, decimal)) < FEWEST_NUMBERS:
            return False
        for place, cell in enumerate(row):
            if cell.strip() and kinds.setdefault(place, is_number(cell, decimal)) != is_number(cell, decimal):
                return False
    return True


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell holds a number with this decimal mark.

    Args:
        cell: its text.
        decimal: mark in numbers, a point or a comma.
    """
    return bool(NUMBER[decimal].fullmatch(cell.strip()))


def _numbers(row: Sequence[str], decimal: str) -> list[bool]:
    return [is_number(cell, decimal) for cell in _used(row)]


def _used(row: Sequence[str]) -> Sequence[str]:
    """The cells without empty ones at the end."""
    width = len(row)
    while width and not row[width - 1].strip():
        width -= 1
    return row[:width]


def _row_above(rows: Sequence[Sequence[str]], below: int, width: int) -> int | None:
    """The nearest row above that is not empty and as wide."""
    for place in range(below - 1, -1, -1):
        if any(cell.strip() for cell in rows[place]):
            return place if len(rows[place]) >= width and len(_used(rows[place])) >= 2 else None
    return None


def _titles(rows: Sequence[Sequence[str]], header: int) -> tuple[str, ...]:
    return tuple(" ".join(cell.split()) for cell in rows[header - 1]) if header else ()


def _units(row: Sequence[str], width: int) -> list[str] | None:
    """The units, if this row holds nothing else and at least two of them; cells may be empty."""
    units = [cell.strip().strip(_BRACKETS).strip() for cell in row[:width]]
    known = sum(dimension_of(normalise(unit)) is not None for unit in units)
    bracketed = all(not cell.strip() or cell.strip()[0] in _BRACKETS for cell in row[:width])
    return units if known >= 2 and (bracketed or known == sum(map(bool, units))) else None


def _names(rows: Sequence[Sequence[str]], header: int, width: int) -> tuple[str, ...]:
    """The names; LabVIEW's units stand far above them."""
    names = _clean(rows[header], max(width, len(_used(rows[header]))))
    if names[0] != _LABVIEW[0]:
        return names
    said = {row[0]: row for row in rows[:header] if row}
    of_x = "Time [s]" if "Time" in said.get(_LABVIEW[2], ()) else names[0]
    units = [*said.get(_LABVIEW[1], ()), *[""] * len(names)][: len(names)]
    return (of_x, *(f"{name} [{u}]" if u else name for name, u in zip(names[1:], units[1:], strict=True)))


def _clean(row: Sequence[str], width: int) -> tuple[str, ...]:
    """Names without marks of a comment; a column without a name is called by its number."""
    cells = [" ".join(cell.split()) for cell in row[:width]]
    cells[0] = cells[0].lstrip(_COMMENT)
    return tuple(cell or f"column {number}" for number, cell in enumerate(cells, 1))


DELIMITERS = (",", ";", "\t", "|")
BLANKS = " "  # one or more between cells
_LOOKED_AT = 1 << 18  # bytes
_MOST_LINES = 400
_BLANK = re.compile(r"\s+(?![\[(])")  # none between a name and its unit


@dataclass(frozen=True)
class TextDialect:
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
        parts = [f"cells between {names[self.delimiter]}"] if self.delimiter in names else []
        parts += ["decimal commas"] if self.decimal == "," else []
        return (*parts, *preamble_words(self.skipped))


def find_dialect(content: bytes) -> TextDialect | None:
    """How a UTF-8 text is written; None where no names are followed by numbers.

    A first line that holds one of palpate's own names is a header, whatever stands below it. Else every
    delimiter and decimal mark is tried, and that which makes the widest table wins.

    Args:
        content: of the file, or its beginning.
    """
    # Byte where each of the first lines begins, and its text; a last one that is cut off is left out.
    head = content[:_LOOKED_AT]
    lines: list[tuple[int, str]] = []
    for match in re.finditer(rb"[^\r\n]*(\r\n|\r|\n|$)", head):
        if len(lines) == _MOST_LINES or (match.end() == len(head) < len(content) and lines):
            break
        if match.group() or match.start() < len(head):
            lines.append((match.start(), match.group().rstrip(b"\r\n").decode(errors="replace")))
    if not lines:
        return None
    first = max(DELIMITERS, key=lines[0][1].count)
    names = [" ".join(name.split()) for name in next(_cells([lines[0][1]], first), [])]
    if any(role and role.unit for role in map(parse_role, names)):
        rows = list(_cells([text for _, text in lines[1:]], first))
        decimal = "," if first != "," and commas_decide(rows) else "."
        named = tuple(name or f"column {number}" for number, name in enumerate(names, 1))
        end = re.compile(rb"\r\n|\r|\n|$").search(content, lines[0][0])
        return TextDialect(first, decimal, named, lines[0][0], end.end() if end else len(content))
    return max(_dialects(lines), key=lambda dialect: len(dialect.names), default=None)


def blanks_as_tabs(content: bytes) -> bytes:
    """The text with each stretch of blanks between cells made one tab.

    Args:
        content: of the rows, UTF-8.
    """
    return re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", re.sub(rb"[ \t]+", b"\t", content))


def _dialects(lines: list[tuple[int, str]]) -> Iterator[TextDialect]:
    """The dialect by each delimiter that makes a table of these lines."""
    for delimiter in (*DELIMITERS, BLANKS):
        rows = list(_cells([text for _, text in lines], delimiter))
        decimal = "," if delimiter != "," and commas_decide(rows) else "."
        layout = find_layout(rows, decimal)
        if layout is not None:
            # As many names as the rows have cells: both may end with the delimiter or a remark.
            width, names = max(len(row) for row in rows[layout.first :][:3]), list(layout.names)
            names += [f"column {number}" for number in range(len(names) + 1, width + 1)]
            skipped = sum(bool(text.strip()) for _, text in lines[: layout.header])
            head, start = (lines[row][0] for row in (layout.header, layout.first))
            named = tuple(names[:width])
            yield TextDialect(delimiter, decimal, named, head, start, skipped, layout.titles)


def is_footer(line: str, dialect: TextDialect) -> bool:
    """Whether a line below the rows is none of them: empty, or words. A row that is cut off is one.

    Args:
        line: without its end.
        dialect: of the file.
    """
    cells = [cell for cell in next(_cells([line], dialect.delimiter), []) if cell.strip()]
    numbers = [is_number(cell, dialect.decimal) for cell in cells]
    return not cells or (not numbers[0] and sum(numbers) < FEWEST_NUMBERS)


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

    Args:
        rows: cells of the first rows, as text.
    """
    marked = [cell for row in rows for cell in map(str.strip, row) if "," in cell or "." in cell]
    readings = [(bool(NUMBER[","].fullmatch(cell)), bool(NUMBER["."].fullmatch(cell))) for cell in marked]
    commas, points = readings.count((True, False)), readings.count((False, True))
    if commas == points == 0:
        return any(both == (True, True) and "," in cell for both, cell in zip(readings, marked, strict=True))
    return commas > points
