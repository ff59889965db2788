"""Times that are written as a clock's, "09:12:03,250" or "2024-03-17 09:12:03.25", as seconds."""

import re
from contextlib import suppress
from datetime import date

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from estimation.data.side_by_side import is_filled, is_text
from robot_io.types import FloatArray

_CLOCK = re.compile(
    r"^\s*(?:(?P<day>\d{4}-\d\d?-\d\d?|\d\d?[./]\d\d?[./]\d{4}|\d{4}/\d\d?/\d\d?)(?:T|,?\s+))?"
    r"(?:(?P<hour>\d{1,3}):)?(?P<minute>\d{1,4}):(?P<second>\d\d?(?:[.,:]\d+)?)"
    r"\s*(?P<half>[AaPp][Mm])?(?:Z|[+-]\d\d:?\d\d)?\s*$",
    re.ASCII,  # as Arrow's expressions are
)
_BLANKS = "[\u00a0\u202f]"  # that some write before AM and PM
_DAY_S = 86400.0
_MARK = {b"clock": b"s"}  # beside the names of columns that hold seconds whatever their names say


def with_seconds(columns: pa.Table, decimal: str) -> tuple[pa.Table, tuple[str, ...]]:
    """The columns with those of clock times as seconds, which `clocks_of` names, and a word on it.

    Args:
        columns: of a file.
        decimal: mark in its numbers.
    """
    done = []
    for place, name in enumerate(columns.column_names):
        text = _as_text(columns.column(place))
        if text is None or not _is_clock(text):
            continue
        parts = pc.extract_regex(pc.replace_substring_regex(text, _BLANKS, " "), _CLOCK.pattern)
        try:
            seconds, order = _seconds(parts)
        except ValueError:  # such as the 0th of a month, which stands for no date
            continue
        if parts.null_count > len(parts) - np.sum(is_filled(text)):  # so that an error can name such a cell
            written = pc.replace_substring(seconds.cast(pa.string()), ".", decimal)
            seconds = pc.if_else(pc.is_null(parts), text, written)
        columns = columns.set_column(place, pa.field(name, seconds.type, metadata=_MARK), seconds)
        done.append(f"'{name}'{order}")
    return columns, (f"clock times in {', '.join(done)}, as seconds",) if done else ()


def clocks_of(columns: pa.Table) -> frozenset[str]:
    """Names of the columns that held clock times and hold seconds now."""
    return frozenset(one.name for one in columns.schema if (one.metadata or {}).items() >= _MARK.items())


def _as_text(column: pa.ChunkedArray) -> pa.ChunkedArray | None:
    """A column of text, coded or not, or of dates with times; None for any other."""
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    return column.cast(pa.string()) if is_text(kind) or pa.types.is_timestamp(kind) else None


def _is_clock(column: pa.ChunkedArray) -> bool:
    first = np.flatnonzero(is_filled(column.slice(0, 1000)))[:1]
    return len(first) > 0 and _CLOCK.match(re.sub(_BLANKS, " ", column[int(first[0])].as_py())) is not None


def _seconds(parts: pa.ChunkedArray) -> tuple[pa.Array, str]:
    """Since midnight of the first day, and the order in the dates; a clock alone goes on after midnight."""
    texts = {name: pc.struct_field(parts, name) for name in ("day", "hour", "minute", "second", "half")}
    hour, minute, second = (_number(texts[name]) for name in ("hour", "minute", "second"))
    half = pc.utf8_upper(texts["half"]).to_numpy(zero_copy_only=False)
    hour = np.where(half == "PM", hour % 12 + 12, np.where(half == "AM", hour % 12, hour))
    days, order = _days(texts["day"])
    seconds = days * _DAY_S + 3600.0 * hour + 60.0 * minute + second
    there = np.isfinite(seconds)
    if texts["day"][0].as_py() in ("", None) and np.max(seconds[there]) < _DAY_S:
        back = np.diff(seconds[there], prepend=0.0) < -_DAY_S / 2.0
        seconds[there] += _DAY_S * np.cumsum(back)
    return pa.array(seconds, from_pandas=True), order


def _number(text: pa.ChunkedArray) -> FloatArray:
    plain = pc.replace_substring_regex(text, "[,:]", ".")
    filled = pc.if_else(pc.equal(plain, ""), "0", plain)
    return np.array(pc.cast(filled, pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)


def _days(text: pa.ChunkedArray) -> tuple[FloatArray, str]:
    """Since the first of the days, and a word on the order of month and day that was taken for all of them.

    Raises:
        ValueError: one of them is none, in either order.
    """
    coded = text.combine_chunks().dictionary_encode()
    texts = coded.dictionary.to_pylist()
    read: dict[str, FloatArray] = {}
    for order in ("month/day", "day/month"):
        with suppress(ValueError):
            read[order] = np.array([_ordinal(day, order) for day in texts], dtype=np.float64)
    if not read:
        raise ValueError(texts)
    order = min(
        read, key=lambda order: float(np.ptp(read[order]))
    )  # the shortest recording is the likely one
    found = read[order][coded.indices.fill_null(0).to_numpy(zero_copy_only=False)]
    told = np.ptp(found) > 0.0 and any("/" in (day or "")[:3] for day in texts)
    return np.asarray(found - found.min()), f" as {order}" if told else ""


def _ordinal(day: str, order: str) -> int:
    """Number of a day. The order counts where a slash stands; before a point the day is first."""
    if not day:
        return 0
    one, two, three = map(int, re.split(r"[-./]", day))
    if one > 31:
        return date(one, two, three).toordinal()
    month, of_month = (one, two) if "/" in day and order == "month/day" else (two, one)
    return date(three, month, of_month).toordinal()
