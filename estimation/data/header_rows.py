"""Where the table begins in what a laboratory's program wrote: preamble, names, units, then numbers."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from estimation.data.units import dimension_of, normalise

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
            return Layout(_with_units(rows[above], units, width), first, above, _titles(rows, above))
    return None


def preamble_words(lines: int) -> tuple[str, ...]:
    """A word on the lines before the names, if there are any."""
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
    """Whether a cell holds a number with this decimal mark."""
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


def _with_units(names: Sequence[str], units: Sequence[str], width: int) -> tuple[str, ...]:
    plain = _clean(names, width)
    return tuple(f"{name} [{unit}]" if unit else name for name, unit in zip(plain, units, strict=True))


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
