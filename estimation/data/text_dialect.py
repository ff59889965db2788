"""Detect separator, decimal mark and header rows of a text table."""

import csv
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, islice, zip_longest
from pathlib import Path

from palpate.estimation.data.column_names import (
    TIME,
    channel_pairs,
    guess_column,
    guess_columns,
    is_unnamed,
    parse_role,
)
from palpate.estimation.data.file_columns import list_first
from palpate.estimation.data.units import dimension_of, normalize_unit
from palpate.robot_io.errors import InputError

_NUMBER = (  # pattern with thousands separator {0} and decimal mark {1}; blanks may also separate thousands
    r"[+-]?(\d+({1}\d*)?|[1-9]\d{{0,2}}(({0}\d{{3}})+|([ \u00a0\u202f]\d{{3}})+)({1}\d*)?|{1}\d+)"
    r"(e[+-]?\d+)?|[+-]?(nan|inf)"
)
NUMBER = {  # pattern by decimal mark; the other mark may separate thousands
    ".": re.compile(_NUMBER.format(",", r"\."), re.IGNORECASE),
    ",": re.compile(_NUMBER.format(r"\.", ","), re.IGNORECASE),
}
MIN_UNMARKED = 100.0  # least number without a decimal mark that may come before "1.000"
_ALIKE = 3  # consecutive lines that are checked to be a table
MIN_SIGNALS = 3  # least number of signals in rows: time, motion and effort
MIN_NUMBERS = 2  # least number of numbers in such a line
_MAX_SETTINGS = 4  # most rows between the names and the numbers
_MAX_TITLES = 3  # rows above the names in which titles of tests, or names of single columns, are searched
_WORDS_ONLY = re.compile(r"[^\W\d_][\w .:-]*")  # one cell, and none with another delimiter
_COMMENT = "#%/;! \ufeff"
_COMMENT_SIGNS = frozenset("#%/;!")
_COMMENTS = ("#", "%", "!", "//")
_LABVIEW = ("X_Value", "Y_Unit_Label", "X_Dimension")
_BRACKETS = "[](){}<>"
_LIKE_A_UNIT = re.compile(r"[%‰]|[\w°%]{1,8}(?:[ ./·⋅*^_-]+[\w°]{1,8})*")
CLOCK = re.compile(
    r"^\s*(?:(?P<day>\d{4}-\d\d?-\d\d?|\d\d?[./]\d\d?[./]\d{4}|\d{4}/\d\d?/\d\d?)(?:T|,?\s+))?"
    r"(?:(?P<hour>\d{1,3}):)?(?P<minute>\d{1,4}):(?P<second>\d\d?(?:[.,:]\d+)?)"
    r"\s*(?P<half>[AaPp][Mm])?(?P<zone>Z|[+-]\d\d:?\d\d)?\s*$",
    re.ASCII,  # as Arrow's expressions are
)
MISSING = frozenset(
    ["", "-", "--", "---", "#n/a", "n/a", "na", "nan", "#nv", "#wert!", "#value!", "#div/0!", "null", "none"]
)


@dataclass(frozen=True)
class TableLayout:
    """Position of names and numbers among rows of cells."""

    names: tuple[str, ...]  # column names; units from a row of units follow in brackets
    first: int  # index of the first row of numbers
    header: int  # index of the row of names
    titles: tuple[str, ...] = ()  # cells of a row above the names that differ


def find_layouts(rows: Sequence[Sequence[str]], decimal: str) -> Iterator[TableLayout]:
    """Yield the layout of each table: a row of names, and perhaps one of units, directly above numbers.

    Args:
        rows: cells of the file's rows, as text.
        decimal: decimal mark.
    """
    is_body = _is_body(rows[:_ALIKE], decimal)
    for first in range(1, len(rows)):
        body = rows[first : first + _ALIKE]
        was_body, is_body = is_body, _is_body(body, decimal)
        if not is_body or was_body:
            continue
        width = max(len(_strip_empty(row)) for row in body)
        remarks = dict[str, Sequence[str]]()  # with one entry per column, such as "# columns: a b c"
        for row in reversed(rows[:first]):
            is_remark = bool(row) and row[0].endswith(":")
            if not is_remark and sum(_are_numbers(row, decimal)) >= MIN_NUMBERS:
                break  # another table
            if is_remark and len(row) == width + 1:
                remarks.setdefault(row[0].rstrip(":").lower(), row[1:])
        if "columns" in remarks:
            yield TableLayout(_with_units(remarks["columns"], remarks.get("units", ())), first, first - 1)
            continue
        header = _header_rows(rows, first, width, decimal)
        if not header:
            continue
        units_by_row = [_units_in(row, width) for _, row in header]
        with_units = next((number for number, units in enumerate(units_by_row) if units), None)
        # Numbers of the row of names and of that of units.
        choices: list[tuple[int, int | None]] = [(0, None)]
        if len(header) > 1 and bool(units_by_row[0]) != bool(units_by_row[1]):
            choices = [(1, 0)] if units_by_row[0] else [(0, 1)]
        # Rows of other words, such as channels, may be between names and numbers.
        choices += [(number, with_units) for number, units in enumerate(units_by_row) if not units]
        layouts = list[TableLayout]()
        for number, of_units in dict.fromkeys(choices):
            units = [] if of_units is None else units_by_row[of_units]
            top = min(header[number][0], header[number if of_units is None else of_units][0])
            names = _with_units(_clean_names(rows, *header[number], width), units)
            titles: tuple[str, ...] = ()  # of the lowest row that names each test differently
            for row in reversed(rows[max(top - _MAX_TITLES, 0) : top]):
                filled = [cell for cell in row if cell.strip()]
                if not titles and 1 < len(filled) == len(set(filled)):
                    titles = tuple(" ".join(cell.split()) for cell in row)
            layouts.append(TableLayout(names, first, top, titles))
        is_clear = len(layouts) == 1
        yield next((each for each in layouts if is_clear or _is_measurement(each.names)), layouts[0])


def _is_body(body: Sequence[Sequence[str]], decimal: str) -> bool:
    """Return whether rows are the first of a table: each column has only numbers or only words."""
    rows = [row for row in body if any(row) or row is body[0]]
    for row in rows:
        count = sum(_are_numbers(row, decimal))
        if count + (0 < count < MIN_NUMBERS and any(map(CLOCK.match, row))) < MIN_NUMBERS:
            return False
    columns = zip_longest(*body, fillvalue="")
    kinds = ({is_number(cell, decimal) for cell in column if not is_missing(cell)} for column in columns)
    return all(len(kind) <= 1 for kind in kinds)


def _header_rows(
    rows: Sequence[Sequence[str]], first: int, width: int, decimal: str
) -> list[tuple[int, Sequence[str]]]:
    """Return index and cells of at most three rows of names or units above a table, the lowest one first."""
    body = rows[first : first + _ALIKE]
    labels = [row[0].strip().strip('"') for row in body if row]
    counted = [[str(begin + place) for place in range(len(labels))] for begin in (0, 1)]
    has_labels = labels in counted or not any(name == "" or is_number(name, decimal) for name in labels)
    filled_columns = {column for row in body for column, cell in enumerate(row) if not is_missing(cell)}
    only_numbers = all(is_missing(cell) or is_number(cell, decimal) for cell in body[0])  # of this delimiter
    header: list[tuple[int, Sequence[str]]] = []
    for place in range(first - 1, -1, -1):
        if not any(char.isalnum() for cell in rows[place] for char in cell):
            continue  # blank, or a line of dashes
        # A number above an empty column numbers the tests and is not a name.
        row = [
            "" if column not in filled_columns and is_number(cell, decimal) else cell
            for column, cell in enumerate(rows[place])
        ]
        filled = sum(map(bool, map(str.strip, row)))
        # Such as the channel of one column, or words that mark the end of the header.
        word = row[0].strip()
        is_remark = filled < 2 and (
            not word or word.isalpha() or bool(_WORDS_ONLY.fullmatch(word) and only_numbers)
        )
        is_setting = (  # such as "Range,10,50,100"
            len(_strip_empty(row)) <= len(_strip_empty(body[0]))
            and is_number(body[0][0], decimal)
            and (row[0].strip() and not is_number(row[0], decimal))
            and any(_are_numbers(row[1:], decimal))
        )
        is_comment = row[0].lstrip().startswith(_COMMENTS) and len(row) < width
        if not header and first - place <= _MAX_SETTINGS and (is_remark or is_setting or is_comment):
            continue
        if has_labels and len(_strip_empty(row)) == width - 1:  # R writes no name for the row labels
            row = ["", *row]
        if len(row) < width or filled < 2 or any(_are_numbers(row, decimal)):
            break
        header.append((place, row))
        if len(header) == 3:
            break
    return header


def _with_units(names: Sequence[str], units: Sequence[str]) -> tuple[str, ...]:
    """Append a unit in brackets to each name that has one; missing units are at the end."""
    pairs = zip_longest(names, units, fillvalue="")
    return tuple(f"{name} [{unit}]" if unit else name for name, unit in pairs)


def are_signals(rows: Sequence[Sequence[str]], decimal: str) -> bool:
    """Return whether each row holds a signal: a name, perhaps a unit, and more numbers than there are rows.

    Args:
        rows: cells of all rows, as text.
        decimal: decimal mark.
    """
    return MIN_SIGNALS <= len(rows) < min(map(len, rows), default=0) - 1 and all(
        not is_missing(row[0])
        and not is_number(row[0], decimal)
        and all(is_missing(cell) or is_number(cell, decimal) for cell in row[2:])
        for row in rows
    )


def numbered_names(count: int) -> tuple[str, ...]:
    """Return the names of columns without names: "column 1", "column 2" and so on."""
    return tuple(f"column {number}" for number in range(1, count + 1))


@lru_cache(maxsize=1024)  # each cell is tested for several rows with which a table may begin
def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell contains a number with this decimal mark.

    Args:
        cell: text of the cell.
        decimal: decimal mark, a point or a comma.
    """
    return bool(NUMBER[decimal].fullmatch(cell.strip()))


def _are_numbers(row: Sequence[str], decimal: str) -> list[bool]:
    return [is_number(cell, decimal) for cell in _strip_empty(row)]


def _strip_empty(row: Sequence[str]) -> Sequence[str]:
    """Remove empty cells at the end of a row."""
    return row[: max((place for place, cell in enumerate(row, 1) if cell.strip()), default=0)]


def thousands_ambiguity(texts: Iterator[str], largest_unmarked: float, decimal: str) -> str:
    """Describe a number that may be read a thousand times too small, such as "1.000" after "999".

    Args:
        texts: all numbers of a column that have a decimal mark, as text.
        largest_unmarked: largest absolute value of the other numbers of the column.
        decimal: decimal mark.

    Returns:
        The first text with both meanings, if each text could have a thousands separator in the place of the
        mark and others of at least `MIN_UNMARKED` have none; otherwise empty.
    """
    grouped, first = re.compile(rf"[+-]?[1-9]\d{{0,2}}{re.escape(decimal)}\d{{3}}"), next(texts, "")
    if largest_unmarked < MIN_UNMARKED or not all(map(grouped.fullmatch, chain([first], texts))):
        return ""
    value = float(first.replace(decimal, "."))
    return f"'{first}' may mean {value:g} or {1000.0 * value:g}"


def is_missing(cell: str) -> bool:
    """Return whether a cell marks a missing value: empty, "-", "#N/A" or similar.

    Args:
        cell: text of the cell.
    """
    return cell.strip().lower() in MISSING


def _units_in(row: Sequence[str], width: int) -> list[str]:
    """Return the units in a row that contains only units, at least two of them known; else none."""
    row = [row[0].lstrip(_COMMENT) or row[0], *row[1:width]]  # a first column in percent is no comment
    units = [cell.strip().strip(_BRACKETS).strip() for cell in row]
    units = [unit if any(char.isalnum() or char in "%°" for char in unit) else "" for unit in units]
    known = sum(dimension_of(normalize_unit(unit)) is not None for unit in units)
    filled = sum(map(bool, units))
    bracketed = all(not cell.strip() or cell.strip()[0] in _BRACKETS for cell in row)
    like_units = 2 * known >= filled and all(not unit or _LIKE_A_UNIT.fullmatch(unit) for unit in units)
    return units if known >= 2 and (bracketed or like_units) else []


def _clean_names(
    rows: Sequence[Sequence[str]], header: int, row: Sequence[str], width: int
) -> tuple[str, ...]:
    """Return names without comment signs, or "column N"; add LabVIEW's units from its preamble."""
    cells = [" ".join(cell.split()) for cell in row[: max(width, len(_strip_empty(row)))]]
    cells[0] = cells[0].lstrip(_COMMENT)
    for above in reversed(rows[max(header - _MAX_TITLES, 0) : header]):  # as in a header with merged cells
        known = (cell if guess_column(cell).quantity else "" for cell in above)
        cells = [cell or name for cell, name in zip_longest(cells, islice(known, len(cells)), fillvalue="")]
    names = tuple(cell or f"column {number}" for number, cell in enumerate(cells, 1))
    if names[0] != _LABVIEW[0]:
        return names
    rows_by_label = {row[0]: row for row in rows[:header] if row}
    first = "Time [s]" if "Time" in rows_by_label.get(_LABVIEW[2], ()) else names[0]
    return first, *_with_units(names[1:], rows_by_label.get(_LABVIEW[1], ())[1 : len(names)])


NAMELESS, OMITTED = "no names of columns", "not read, because the columns differ"
DELIMITERS = (",", ";", "\t", "|")
BLANKS = " "  # one or more blanks between cells
_LOOKED_AT = 1 << 18  # bytes
_MAX_LINES = 400
_LINE = re.compile(rb"[^\n]*(\n|$)")
_WORDS = re.compile(  # a line that begins with a word, possibly after the number of a test
    rb"\n[ \t,;|\"']*(?:\d+[\"']?[ \t]*[,;|\t][ \t,;|\"']*)?[A-Za-z(\[{<#%/!\x80-\xff][^\r\n]*"
)
# Cells with numbers
_CELLS = re.compile(rb"(?:^|[\r\n\t,;|])[ \"]*[-+]?[\d.,]*\d(?:[eE][-+]?\d+)?[ \"]*(?=$|[\t,;|])")
_MAX_HEADERS, _BELOW = 10_000, 8  # most lines with words, and lines below each, that are examined
_LEFT_OUT = "..."  # neither words nor numbers
_BLANK = re.compile(r"[ \t]+(?![\[(])")  # except a blank between a name and its unit
_ANY_BLANK, _ONLY_UNITS = re.compile(r"[ \t]+"), re.compile(r"([\[(][^])]*[])][ \t]*)+")  # "(s) (mm) (N)"


@dataclass(frozen=True)
class TextTable:
    """Position of one table in a text file."""

    names: tuple[str, ...]  # column names
    head: int  # first byte of the header
    start: int  # first byte of the first row of numbers
    titles: tuple[str, ...] = ()  # cells of the row above the header
    counts: bool = False  # whether the first column contains numbers
    numbers: int = 0  # number of columns with numbers


@dataclass(frozen=True)
class TextDialect:
    """Delimiter, decimal mark and tables of a text file."""

    delimiter: str  # delimiter between cells
    decimal: str  # decimal mark
    tables: tuple[TextTable, ...]  # tables in their order, at least one

    @property
    def notes(self) -> tuple[str, ...]:
        """Differences from a plain CSV file."""
        names = {";": "semicolons", "\t": "tabs", "|": "bars", BLANKS: "blanks"}
        parts = [f"cells separated by {names[self.delimiter]}"] if self.delimiter in names else []
        return (*parts, *(["decimal commas"] if self.decimal == "," else []))


def find_dialect(content: bytes) -> TextDialect | None:
    """Detect delimiter and decimal mark of a UTF-8 text; None if no header is followed by numbers.

    If the first line contains one of palpate's own names, it is a header. Otherwise each delimiter is tried
    with the decimal mark that suits it, and the dialect whose longest table has most columns of numbers is
    returned.

    Args:
        content: content of the file.
    """
    lines = _sample_lines(content)
    if not lines:
        return None
    first = max(DELIMITERS, key=lines[0][1].count)
    begin = lines[0][0]
    end = content.find(b"\n", begin) + 1 or len(content)
    # Read the whole header line, since a line of the sample may be truncated.
    header = content[begin:end].decode(errors="replace").rstrip("\r\n")
    names = [" ".join(name.split()) for name in next(_cells([header], first), [])]
    if any(role and role.unit for role in map(parse_role, names)):
        named = tuple(name or f"column {number}" for number, name in enumerate(names, 1))
        dialect = _dialect(lines, first)
        counts = len(lines) > 1 and is_number(line_cells(lines[1][1] + first, first)[0], dialect.decimal)
        first_table = TextTable(named, begin, end, (), counts)
        return replace(dialect, tables=(first_table, *(t for t in dialect.tables if t.head > begin)))
    # A tab may be the delimiter, and is also a blank.
    separate = {*"".join(text for _, text in lines).replace("\t", "\t ")}
    dialects = [_dialect(lines, delimiter) for delimiter in (*DELIMITERS, BLANKS) if delimiter in separate]

    def column_counts(dialect: TextDialect) -> tuple[int, int]:
        """Return how many columns of the longest table have numbers, and how many there are."""
        heads = [*(table.head for table in dialect.tables[1:]), len(content)]
        sizes = [end - table.start for end, table in zip(heads, dialect.tables, strict=True)]
        longest = dialect.tables[sizes.index(max(sizes))]
        return longest.numbers, len(longest.names)

    with_names = [dialect for dialect in dialects if dialect.tables]
    if with_names:
        return max(with_names, key=column_counts)
    # of rows of numbers without names, the dialect with the fewest words
    comments = next((n for n, (_, text) in enumerate(lines) if text[:1] not in _COMMENT_SIGNS), 0)
    begin, texts = lines[comments][0], [text for _, text in lines[comments:][:_ALIKE]]
    options = list[tuple[int, TextDialect]]()
    for delimiter in (*DELIMITERS, BLANKS):
        rows = list(_cells(texts, delimiter))
        decimal = decimal_mark(rows, in_doubt=delimiter != ",")
        columns, numbers = len(rows[0]), [sum(_are_numbers(row, decimal)) for row in rows]
        if columns >= MIN_NUMBERS <= min(numbers) and all(len(row) == columns for row in rows):
            words = sum(not is_missing(cell) for row in rows for cell in row) - sum(numbers)
            table = TextTable(numbered_names(columns), begin, begin, (), True)
            options.append((words, TextDialect(delimiter, decimal, (table,))))
    return min(options, key=lambda option: option[0], default=(0, None))[1]


def _sample_lines(content: bytes) -> list[tuple[int, str]]:
    """Return position and text of the file's first lines, and of later lines of words and those below."""
    lines: list[tuple[int, str]] = []

    def take(begin: int, end: int, most: int) -> int:
        for match in islice(_LINE.finditer(content, begin, end), most):
            if match.end() == end < len(content) and lines:
                break
            if match.group():
                lines.append((match.start(), match.group().rstrip(b"\r\n").decode(errors="replace")))
                begin = match.end()
        return begin

    end = take(0, min(len(content), _LOOKED_AT), _MAX_LINES)
    words = (match for match in _WORDS.finditer(content, end - 1) if len(_CELLS.findall(match.group())) < 2)
    for match in islice(words, _MAX_HEADERS):
        begin = max(match.start() + 1, end)
        if begin > end:
            lines.append((end, _LEFT_OUT))
        end = take(begin, min(len(content), begin + _LOOKED_AT), _BELOW)
    return lines


def _dialect(lines: list[tuple[int, str]], delimiter: str) -> TextDialect:
    """Return the dialect for this delimiter with the tables that it gives in these lines, possibly none."""
    rows = list(_cells([text for _, text in lines], delimiter))
    decimal = decimal_mark(rows, in_doubt=delimiter != ",")
    tables = []
    for layout in find_layouts(rows, decimal):
        # Use as many names as the rows have cells: both may end with the delimiter or a remark.
        body = rows[layout.first : layout.first + _ALIKE]
        width, names = max(map(len, body)), list(layout.names)
        is_remark = any(not is_unnamed(word) for word in names[width:])  # words beyond the last column
        numbers = max(sum(_are_numbers(row, decimal)) for row in body)
        is_split = numbers < MIN_NUMBERS  # as a date and a clock are
        if delimiter == BLANKS and (is_split or (is_remark and not _is_measurement(names))):
            continue
        names += numbered_names(width)[len(names) :]
        head, start = (lines[row][0] for row in (layout.header, layout.first))
        counts = is_number(body[0][0], decimal)
        tables.append(TextTable(tuple(names[:width]), head, start, layout.titles, counts, numbers))
    return TextDialect(delimiter, decimal, tuple(tables))


def is_footer(cells: Sequence[str], *, counts: bool) -> bool:
    """Return whether a row after a table is not part of it because it is empty or contains words.

    A row of numbers with the other decimal mark is part of the table.

    Args:
        cells: cells of the row, as text.
        counts: whether the first column of the table holds numbers, so that a word there ends the table.
    """
    filled = [cell for cell in cells if cell.strip()]
    numbers = [any(is_number(cell, mark) for mark in NUMBER) for cell in filled]
    if any(numbers) and not counts and CLOCK.match(filled[0]):  # a clock beside a number
        numbers[0] = True
    words = bool(filled) and not numbers[0]
    return not filled or (words and (sum(numbers) < MIN_NUMBERS or (counts and not is_missing(cells[0]))))


def line_cells(line: str, delimiter: str) -> list[str]:
    """Split a line into cells.

    Args:
        line: text of the line without its end.
        delimiter: delimiter between cells.
    """
    return next(_cells([line], delimiter), [])


def _cells(lines: list[str], delimiter: str) -> Iterator[list[str]]:
    if delimiter == BLANKS:
        for line in lines:
            plain = line.strip(" \t").lstrip(" \t#%")  # a unit at the end may be "%"
            between = _ANY_BLANK if _ONLY_UNITS.fullmatch(plain) else _BLANK
            yield [cell.strip('"') for cell in between.split(plain)]
        return
    for line in lines:
        try:
            yield next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
        except csv.Error:  # a cell of more than 128 KiB
            yield [line]


def decimal_mark(rows: Sequence[Sequence[str]], *, in_doubt: bool = True) -> str:
    """Return the decimal mark of numbers, a comma or a point.

    "1,234" is ambiguous: it can mean 1.234 or 1234.

    Args:
        rows: cells of the first rows, as text.
        in_doubt: whether "1,234" means 1.234 if no other number decides.
    """
    marked = [cell for row in rows for cell in map(str.strip, row) if "," in cell or "." in cell]
    readings = [(is_number(cell, ","), is_number(cell, ".")) for cell in marked]
    commas, points = readings.count((True, False)), readings.count((False, True))
    if commas == points == 0:
        ambiguous = (cell for cell, both in zip(marked, readings, strict=True) if all(both))
        return "," if in_doubt and any("," in cell for cell in ambiguous) else "."
    return "," if commas > points else "."


def _is_measurement(names: Sequence[str]) -> bool:
    """Return whether these names form a channel: a time, a motion and an effort."""
    available = {guess.key for guess in guess_columns(names) if guess.quantity}
    return TIME in available and bool(channel_pairs(available))


@dataclass(frozen=True)
class TableBlock:
    """Names and length of one table of a file."""

    title: str  # name of its sheet, or number of its first line, or both: "Sheet1:24"
    names: tuple[str, ...]  # column names
    rows: int


def same_columns(blocks: Sequence[TableBlock], selected: str, place: Path) -> tuple[list[int], list[str]]:
    """Select the longest table that forms a channel and all with the same columns, or the requested one.

    Args:
        blocks: tables, at least one.
        selected: title of the requested table; empty for the longest table that forms a channel, or the
            longest of all if none does.
        place: path of the file, for the error message.

    Returns:
        Indices of the tables in their order, and notes on the omitted tables (empty if there are none).

    Raises:
        InputError: no table has this title.
    """
    titled = [b for b in blocks if selected in ("", b.title, b.title.rpartition(":")[0])]
    if not titled:
        titles = ", ".join(dict.fromkeys(block.title for block in blocks))
        raise InputError(f"--table {selected}: {place} has no such table. Available: {titles}")
    longest = max(
        titled,
        key=lambda block: (_is_measurement(block.names), not all(map(is_unnamed, block.names)), block.rows),
    )
    same = [n for n, block in enumerate(blocks) if sorted(block.names) == sorted(longest.names)]
    chosen = [n for n in same if blocks[n] in titled]
    omitted = [block for number, block in enumerate(blocks) if number not in same]
    if not omitted:
        return chosen, []
    sizes = [
        f"{'line ' * b.title.isdecimal()}'{b.title}' ({b.rows:,} row{'s' * (b.rows != 1)})" for b in omitted
    ]
    option = f"--table {shlex.quote(omitted[0].title)}"
    note = f"{OMITTED}: {list_first(sizes)}; {option} reads one"
    # A line of words among the rows, such as a remark with as many cells, looks like column names.
    alike = (block for block in omitted if len(block.names) == len(longest.names))
    doubtful = next((block.title for block in alike if not _is_measurement(block.names)), "")
    if doubtful.isdecimal() and not selected:
        note += f"; if line {doubtful} names no columns, remove it"
    return chosen, [note]
