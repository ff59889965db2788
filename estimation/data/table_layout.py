"""Convert clock times to seconds, and tests side by side to runs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import date

import numpy as np

from palpate.estimation.data.column_names import RUN, RUN_AFTER_UNIT, guess_columns, quantity_in, split_unit
from palpate.estimation.data.file_columns import pa, pc
from palpate.estimation.data.text_dialect import CLOCK, MISSING
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_MIN_COUNT = 2  # least number of repeated columns in each test; a single repeated column is a mistake
_NANOSECONDS = re.compile(r"(.*?)(?:nanosecs?|nanoseconds|nsecs?)", re.IGNORECASE)
_NUMBER = re.compile(r"[ _.(#-]*\d+\)?\s*$")
_OF_A_PRESS = {"time", "displacement", "force"}
_MOTIONS, _EFFORTS = {"displacement", "position", "velocity"}, {"force", "torque", "goal"}


def find_tests(names: Sequence[str]) -> list[dict[str, int]]:
    """Find tests side by side in one table.

    A column that occurs once belongs to all tests. A motion and an effort must repeat, unless a name is
    unknown: other columns that occur twice are mistakes. Names may end in the number of a test, such as
    "Force 2". Then time, displacement and force must all repeat, to distinguish tests from joints.

    Args:
        names: names of the columns, in their order.

    Returns:
        For each test, the index of each column by its name; empty for a single test.
    """
    if tests := _repeated_names([RUN_AFTER_UNIT.sub("", name) for name in names]):
        repeated = [name for name, place in tests[0].items() if tests[1][name] != place]
        known = {guess.quantity or quantity_in(guess.column) for guess in guess_columns(repeated)} - {"time"}
        if "" in known or not known or (known & _MOTIONS and known & _EFFORTS):
            return tests
    plain = []
    for name in names:
        stem, unit = split_unit(name)
        plain.append(_NUMBER.sub("", stem).strip() + (f" [{unit}]" if unit else ""))
    repeated = [name for name in dict.fromkeys(plain) if plain.count(name) > 1]
    is_press = {guess.quantity for guess in guess_columns(repeated)} >= _OF_A_PRESS
    return _repeated_names(plain) if is_press else []


def stack_tests(
    columns: pa.Table, tests: Sequence[Mapping[str, int]], titles: Sequence[str], decimal: str
) -> tuple[pa.Table, IntArray]:
    """Stack the rows of tests and add a run column; also return the original index of each row.

    Args:
        columns: columns of n rows.
        tests: result of `find_tests`.
        titles: text above each column; it names the tests if a distinct title is above the columns of each.
        decimal: decimal mark of numbers that are text.
    """
    repeated = [name for name, place in tests[0].items() if tests[1][name] != place]
    places = ([place for name, place in test.items() if name in repeated] for test in tests)
    above = [next((title for n, title in enumerate(titles) if title and n in own), "") for own in places]
    named = above if all(above) else [title for title in titles if title]
    labels = named if len(set(named)) == len(tests) == len(named) else range(1, len(tests) + 1)
    parts, rows = [], []
    for test, label in zip(tests, labels, strict=True):
        cells = {name: columns.column(place) for name, place in test.items()}
        filled = np.logical_or.reduce([is_filled(cells[name]) for name in repeated])
        for name, column in cells.items():  # to text, since types may differ between tests
            if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
                cells[name] = pc.replace_substring(column.cast(pa.string()), ".", decimal)
        parts.append(with_run(pa.table(cells), str(label)).filter(pa.array(filled)))
        rows.append(np.flatnonzero(filled))
    return pa.concat_tables(parts, promote_options="permissive"), np.concatenate(rows)


def matching_places(names: Sequence[str], reference: Sequence[str]) -> list[int]:
    """Return the index in `names` of each reference name; repeated names keep their order.

    Args:
        names: names of columns.
        reference: the same names in another order.
    """
    by_name = sorted(range(len(names)), key=names.__getitem__)
    by_reference = sorted(range(len(reference)), key=reference.__getitem__)
    return [place for _, place in sorted(zip(by_reference, by_name, strict=True))]


def with_run(columns: pa.Table, label: str) -> pa.Table:
    """Add a run column with a label, or append the label to the values of an existing run column.

    Args:
        columns: columns of one test.
        label: name of the test.
    """
    places = [place for place, name in enumerate(columns.column_names) if name == RUN]
    for place in places:  # there are several if tests are side by side
        labels = pc.binary_join_element_wise(columns.column(place).cast(pa.string()), label, " ")
        columns = columns.set_column(place, RUN, labels)
    return columns if places else columns.append_column(RUN, pa.repeat(label, len(columns)))


def is_filled(column: pa.ChunkedArray) -> BoolArray:
    """Return the rows in which a column is not empty, shape (n,).

    Args:
        column: column of n cells.
    """
    filled = pc.is_valid(column)
    if is_text(column.type):
        plain = pc.utf8_lower(pc.utf8_trim_whitespace(column))
        filled = pc.and_(filled, pc.invert(pc.is_in(plain, pa.array(sorted(MISSING)))))
    elif pa.types.is_floating(column.type):  # data frames fill shorter columns with NaN
        filled = pc.and_kleene(filled, pc.invert(pc.is_nan(column)))
    return np.asarray(pc.fill_null(filled, False).to_numpy(zero_copy_only=False), dtype=np.bool_)


def is_text(kind: pa.DataType) -> bool:
    """Return whether a column of this type contains text."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _repeated_names(names: Sequence[str]) -> list[dict[str, int]]:
    places: dict[str, list[int]] = {}
    for place, name in enumerate(names):
        places.setdefault(name, []).append(place)
    counts = {len(columns) for columns in places.values()} - {1}
    if len(counts) != 1 or sum(len(columns) > 1 for columns in places.values()) < _MIN_COUNT:
        return []
    return [
        {name: columns[min(test, len(columns) - 1)] for name, columns in places.items()}
        for test in range(*counts)
    ]


_BLANKS = "[\u00a0\u202f]"  # blanks that may precede AM and PM
_DAY_S = 86400.0
CLOCK_MARK = {b"clock": b"s"}  # metadata of columns converted to seconds, whose names may state another unit


def _with_nanoseconds(columns: pa.Table) -> tuple[pa.Table, list[str]]:
    """Add columns such as "nanosec" to whole seconds, such as "sec", which then count from the first row."""
    done, place_of = list[str](), {name.lower(): place for place, name in enumerate(columns.column_names)}
    for name in columns.column_names:
        match = _NANOSECONDS.fullmatch(name)
        stems = (f"{match[1]}{ending}".lower() for ending in ("sec", "secs", "seconds")) if match else ()
        place = next((place_of[stem] for stem in stems if stem in place_of), None)
        if place is None:
            continue
        with suppress(pa.ArrowInvalid):
            whole, part = (pc.cast(column, pa.float64()) for column in (columns.column(place), columns[name]))
            seconds = pc.add(pc.subtract(whole, pc.min(whole)), pc.multiply(part, 1e-9))
            clock = columns.column_names[place]
            columns = columns.set_column(place, pa.field(clock, seconds.type, metadata=CLOCK_MARK), seconds)
            done.append(f"'{clock}' with '{name}'")
    return columns, done


def with_seconds(columns: pa.Table, decimal: str) -> tuple[pa.Table, tuple[str, ...]]:
    """Convert columns of clock times to seconds since midnight of the first day, with a note for the user.

    Args:
        columns: columns of a file.
        decimal: decimal mark of its numbers.
    """
    columns, done = _with_nanoseconds(columns)
    for place, name in enumerate(columns.column_names):
        column = columns.column(place)
        kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
        text = column.cast(pa.string()) if is_text(kind) or pa.types.is_timestamp(kind) else None
        if text is None:
            continue
        first = np.flatnonzero(is_filled(text.slice(0, 1000)))[:1]
        if not len(first) or not CLOCK.match(re.sub(_BLANKS, " ", text[int(first[0])].as_py())):
            continue
        parts = pc.extract_regex(pc.replace_substring_regex(text, _BLANKS, " "), CLOCK.pattern)
        texts = {key: pc.struct_field(parts, key) for key in CLOCK.groupindex}
        try:
            days, order = _days(texts["day"])
        except ValueError:  # an invalid date, such as the 0th of a month
            continue
        points = (
            pc.replace_substring_regex(part, "[,:]", ".")
            for part in (texts["hour"], texts["minute"], _padded(texts["second"]))
        )
        filled = (pc.cast(pc.if_else(pc.equal(part, ""), "0", part), pa.float64()) for part in points)
        hour, minute, second = (np.asarray(numbers.to_numpy(zero_copy_only=False)) for numbers in filled)
        half = pc.utf8_upper(texts["half"]).to_numpy(zero_copy_only=False)
        hour = np.where(half == "PM", hour % 12 + 12, np.where(half == "AM", hour % 12, hour))
        since_s = days * _DAY_S + 3600.0 * hour + 60.0 * minute + second - _zone_changes(texts["zone"])
        known = np.isfinite(since_s)
        if texts["day"][0].as_py() in ("", None) and np.max(since_s[known]) < _DAY_S:  # pass midnight
            since_s[known] += _DAY_S * np.cumsum(np.diff(since_s[known], prepend=0.0) < -_DAY_S / 2.0)
        seconds = pa.array(since_s, from_pandas=True)
        if parts.null_count > len(parts) - np.sum(is_filled(text)):  # keep invalid cells for error messages
            written = pc.replace_substring(seconds.cast(pa.string()), ".", decimal)
            seconds = pc.if_else(pc.is_null(parts), text, written)
        columns = columns.set_column(place, pa.field(name, seconds.type, metadata=CLOCK_MARK), seconds)
        done.append(f"'{name}'{order}")
    return columns, (f"clock times converted to seconds: {', '.join(done)}",) if done else ()


def _zone_changes(zones: pa.ChunkedArray) -> FloatArray:
    """Return the offset of each time from UTC, relative to the first one that is stated [s], shape (n,)."""
    changes_s, first_s = np.zeros(len(zones)), None
    for zone in pc.unique(zones).to_pylist():
        if zone:  # neither missing nor of an invalid cell
            hours, minutes = (0, 0) if zone == "Z" else (int(zone[:3]), int(zone[0] + zone[-2:]))
            offset_s = 3600.0 * hours + 60.0 * minutes
            first_s = offset_s if first_s is None else first_s
            is_zone = pc.fill_null(pc.equal(zones, zone), False).to_numpy(zero_copy_only=False)
            changes_s[is_zone] = offset_s - first_s
    return changes_s


def _padded(seconds: pa.ChunkedArray) -> pa.ChunkedArray:
    """Pad counts of milliseconds, or finer, after a colon with zeros if their numbers of digits differ."""
    digits = pc.utf8_length(pc.struct_field(pc.extract_regex(seconds, r":(?P<count>\d+)$"), "count"))
    least, most = pc.min_max(digits).values()
    if least.as_py() == most.as_py():
        return seconds
    width = -(-most.as_py() // 3) * 3  # milli-, micro- or nanoseconds
    count = pc.utf8_lpad(pc.replace_substring_regex(seconds, ".*:", ""), width, "0")
    return pc.if_else(
        pc.match_substring(seconds, ":"),
        pc.binary_join_element_wise(pc.replace_substring_regex(seconds, ":.*", ""), count, ":"),
        seconds,
    )


def _days(text: pa.ChunkedArray) -> tuple[FloatArray, str]:
    """Return the days since the first day, and a note on the order of day and month; or raise ValueError."""
    coded = text.combine_chunks().dictionary_encode()
    texts = coded.dictionary.to_pylist()
    read: dict[str, FloatArray] = {}
    for order in ("month/day", "day/month"):
        with suppress(ValueError):
            days = []
            for day in texts:  # `order` applies to slashes; with points, the day comes first
                parts = [int(part) for part in re.split(r"[-./]", day)] if day else []
                if parts and parts[0] <= 31:
                    swapped = "/" in day and order == "month/day"
                    parts = [parts[2], *(parts[:2] if swapped else parts[1::-1])]
                days.append(date(*parts).toordinal() if parts else 0)
            read[order] = np.array(days, dtype=np.float64)
    if not read:
        raise ValueError(texts)
    order = min(read, key=lambda order: float(np.ptp(read[order])))  # a shorter recording is more likely
    values = read[order][coded.indices.fill_null(0).to_numpy(zero_copy_only=False)]
    order_matters = np.ptp(values) > 0.0 and any("/" in (day or "")[:3] for day in texts)
    return np.asarray(values - values.min()), f" as {order}" if order_matters else ""
