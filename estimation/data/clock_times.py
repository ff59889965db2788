"""Times that are written as a clock's, "09:12:03,250" or "2024-03-17 09:12:03.25", as seconds."""

import re
from datetime import date

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from estimation.data.quantities import unit_in_name
from estimation.data.side_by_side import is_filled
from robot_io.types import FloatArray

_CLOCK = re.compile(
    r"^\s*(?:(?P<day>\d{4}-\d\d?-\d\d?|\d\d?[./]\d\d?[./]\d{4}|\d{4}/\d\d?/\d\d?)(?:T|,?\s+))?"
    r"(?:(?P<hour>\d{1,3}):)?(?P<minute>\d{1,4}):(?P<second>\d\d?(?:[.,:]\d+)?)"
    r"\s*(?P<half>[AaPp][Mm])?(?:Z|[+-]\d\d:?\d\d)?\s*$"
)
_DAY_S = 86400.0


def with_seconds(columns: pa.Table, decimal: str) -> tuple[pa.Table, tuple[str, ...]]:
    """The columns with those of clock times as seconds, called so, and a word on it.

    Args:
        columns: of a file.
        decimal: mark in its numbers.
    """
    done = []
    for name in (name for name in columns.column_names if _is_clock(columns.column(name))):
        text = columns.column(name)
        parts = pc.extract_regex(text, _CLOCK.pattern)
        try:
            seconds = _seconds(parts)
        except ValueError:  # such as the 0th of a month, which stands for no date
            continue
        if parts.null_count > len(parts) - np.sum(is_filled(text)):  # so that an error can name such a cell
            written = pc.replace_substring(seconds.cast(pa.string()), ".", decimal)
            seconds = pc.if_else(pc.is_null(parts), text, written)
        called = name if unit_in_name(name) else f"{name} [s]"
        columns = columns.set_column(columns.column_names.index(name), called, seconds)
        done.append(f"'{name}'")
    return columns, (f"clock times in {', '.join(done)}, as seconds",) if done else ()


def _is_clock(column: pa.ChunkedArray) -> bool:
    if not pa.types.is_string(column.type):
        return False
    first = np.flatnonzero(is_filled(column.slice(0, 1000)))[:1]
    return len(first) > 0 and _CLOCK.match(column[int(first[0])].as_py()) is not None


def _seconds(parts: pa.ChunkedArray) -> pa.Array:
    """Since midnight of the first day; a clock without a day goes on after midnight."""
    texts = {name: pc.struct_field(parts, name) for name in ("day", "hour", "minute", "second", "half")}
    hour, minute, second = (_number(texts[name]) for name in ("hour", "minute", "second"))
    half = pc.utf8_upper(texts["half"]).to_numpy(zero_copy_only=False)
    hour = np.where(half == "PM", hour % 12 + 12, np.where(half == "AM", hour % 12, hour))
    seconds = _days(texts["day"]) * _DAY_S + 3600.0 * hour + 60.0 * minute + second
    there = np.isfinite(seconds)
    if texts["day"][0].as_py() in ("", None) and np.max(seconds[there]) < _DAY_S:
        seconds[there] = np.unwrap(seconds[there], period=_DAY_S)
    return pa.array(seconds, from_pandas=True)


def _number(text: pa.ChunkedArray) -> FloatArray:
    plain = pc.replace_substring_regex(text, "[,:]", ".")
    filled = pc.if_else(pc.equal(plain, ""), "0", plain)
    return np.array(pc.cast(filled, pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)


def _days(text: pa.ChunkedArray) -> FloatArray:
    """Since the first of the days."""
    coded = text.combine_chunks().dictionary_encode()
    days = np.array([_ordinal(day) for day in coded.dictionary.to_pylist()], dtype=np.float64)
    found = days[coded.indices.fill_null(0).to_numpy(zero_copy_only=False)]
    return np.asarray(found - found.min())


def _ordinal(day: str) -> int:
    """Number of a day. Months stand before days where a slash does, unless there is no such month."""
    if not day:
        return 0
    one, two, three = map(int, re.split(r"[-./]", day))
    if one > 31:
        return date(one, two, three).toordinal()
    month, of_month = (one, two) if "/" in day and one <= 12 else (two, one)
    return date(three, month, of_month).toordinal()
