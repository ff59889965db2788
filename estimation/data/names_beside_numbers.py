"""Name the columns of a table without a header by the words above or between its numbers."""

from __future__ import annotations

import re
import string
from collections.abc import Iterable

from palpate.estimation.data.file_columns import FileColumns, pa, pc
from palpate.estimation.data.table_layout import is_text
from palpate.estimation.data.text_dialect import MIN_SIGNALS, is_number, numbered_names

_LISTED = re.compile(r"[\s#%/;!]*((?:\d{1,3}[\s,.:)-]+)+)([^\d\s].*)")
_VALUE = re.compile(r"\s*(?:\([^)]*)?[:=]|\s[-+]?\d*\.\d")  # ends a name, as "(0 = off)" does
_UNIT_INSIDE = re.compile(r"(.*?)(\[[^]]*])(.+)")


def names_beside_numbers(file: FileColumns) -> dict[int, str]:
    """Return names by the number of the column, from 1; empty if the columns have names, or no words do.

    Args:
        file: columns of a file, which are called "column 1" and so on if they have no names.
    """
    if tuple(file.columns.column_names) != numbered_names(file.columns.num_columns):
        return {}
    return _listed_names(file.preamble, file.columns.num_columns) or _names_in_rows(
        file.columns, file.decimal
    )


def _listed_names(lines: Iterable[str], count: int) -> dict[int, str]:
    """Return names from lines that number the columns, as in "% 2 3 Current left, right [A]: 0.1 0.2"."""
    names = dict[int, str]()
    for match in filter(None, map(_LISTED.fullmatch, lines)):
        places = re.findall(r"\d+", match[1])
        name = _UNIT_INSIDE.sub(r"\1\3 \2", _VALUE.split(match[2])[0])
        words = re.compile(rf"\w+(?:, *\w+){{{len(places) - 1}}}(?![\w,])")  # one for each column
        for number, place in enumerate(places):

            def of_place(found: re.Match[str], number: int = number) -> str:
                return found[0].split(",")[number]

            names[int(place)] = words.sub(of_place, name)
    is_list = len(names) >= MIN_SIGNALS and [*names] == sorted(names) and max(names) <= count
    return names if is_list and 1 in names else {}


def _names_in_rows(columns: pa.Table, decimal: str) -> dict[int, str]:
    """Return names from words that all rows have before their numbers, as in "Time 0.1 Force 3 4"."""
    places = dict[str, list[int]]()
    for place, cells in enumerate(columns.columns, 1):
        first = str(cells[0]).strip() if is_text(cells.type) else ""
        word = "" if is_number(first, decimal) else first.rstrip(string.digits)
        plain = pc.utf8_rtrim(pc.utf8_trim_whitespace(cells), string.digits) if word[:1].isalpha() else None
        if plain is not None and pc.all(pc.equal(plain, word)).as_py():
            places[word] = []
        elif places:
            places[[*places][-1]].append(place)
    return {
        place: f"{word} {number}" if len(named) > 1 else word
        for word, named in (places if len(places) > 1 else {}).items()
        for number, place in enumerate(named, 1)
    }
