"""Several tests side by side in one sheet, whose columns repeat, as runs one below the other."""

import re
from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from estimation.data.column_guess import guess_columns
from estimation.data.quantities import RUN, split_unit
from robot_io.types import BoolArray, IntArray

_FEWEST = 2  # columns that each test has of its own: one that is there twice is a mistake
_NUMBER = re.compile(r"[ _.(#-]*\d+\)?\s*$")
_OF_A_PRESS = {"time", "displacement", "force"}


def find_tests(names: Sequence[str]) -> list[dict[str, int]]:
    """Index of each column by its name, for each test; empty where the columns are those of one.

    A column that is there once belongs to all. Where names end in the test's number, "Force 2", joints are
    told from tests by what repeats: a press and its clock.
    """
    if tests := _repeated(names):
        return tests
    plain = [_without_number(name) for name in names]
    repeated = [name for name in dict.fromkeys(plain) if plain.count(name) > 1]
    of_presses = {guess.quantity for guess in guess_columns(repeated)} >= _OF_A_PRESS
    return _repeated(plain) if of_presses else []


def one_below_the_other(
    columns: pa.Table, tests: Sequence[Mapping[str, int]], titles: Sequence[str], decimal: str = "."
) -> tuple[pa.Table, IntArray]:
    """The tests' rows, with a column of the run, and the index of each among the rows before.

    Args:
        columns: of n rows.
        tests: as `find_tests` gives them.
        titles: what stands above each of the columns; the tests are called so if there is one for each.
        decimal: mark in numbers that are text.
    """
    own = [name for name, place in tests[0].items() if tests[1][name] != place]
    named = [title for title in titles if title]
    labels = named if len(set(named)) == len(tests) == len(named) else range(1, len(tests) + 1)
    parts, rows = [], []
    for test, label in zip(tests, labels, strict=True):
        part = pa.table({name: _as_text(columns.column(place), decimal) for name, place in test.items()})
        there = np.logical_or.reduce([_is_held(columns.column(test[name])) for name in own])
        parts.append(with_run(part, str(label)).filter(pa.array(there)))
        rows.append(np.flatnonzero(there))
    return pa.concat_tables(parts, promote_options="permissive"), np.concatenate(rows)


def with_run(columns: pa.Table, label: str) -> pa.Table:
    """The columns with one that says the run; what says one already goes before the label."""
    places = [place for place, name in enumerate(columns.column_names) if name == RUN]
    for place in places:  # several where tests are side by side
        both = pc.binary_join_element_wise(columns.column(place).cast(pa.string()), label, " ")
        columns = columns.set_column(place, RUN, both)
    return columns if places else columns.append_column(RUN, pa.repeat(label, len(columns)))


def is_filled(column: pa.ChunkedArray) -> BoolArray:
    """In which rows a column holds something, shape (n,)."""
    held = pc.is_valid(column)
    if is_text(column.type):
        held = pc.and_kleene(held, pc.not_equal(pc.utf8_trim_whitespace(column), ""))
    return np.asarray(pc.fill_null(held, False).to_numpy(zero_copy_only=False), dtype=np.bool_)


def is_text(kind: pa.DataType) -> bool:
    """Whether a column of this type holds text."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _is_held(column: pa.ChunkedArray) -> BoolArray:
    """The same; frames fill up what is shorter with NaN."""
    return is_filled(pc.if_else(pc.is_nan(column), None, column) if _is_real(column) else column)


def _as_text(column: pa.ChunkedArray, decimal: str) -> pa.ChunkedArray:
    """A column is text, or real, where one test is shorter than another."""
    if not (_is_real(column) or pa.types.is_integer(column.type)):
        return column
    return pc.replace_substring(column.cast(pa.string()), ".", decimal)


def _is_real(column: pa.ChunkedArray) -> bool:
    return bool(pa.types.is_floating(column.type))


def _repeated(names: Sequence[str]) -> list[dict[str, int]]:
    places: dict[str, list[int]] = {}
    for place, name in enumerate(names):
        places.setdefault(name, []).append(place)
    counts = {len(found) for found in places.values()} - {1}
    if len(counts) != 1 or sum(len(found) > 1 for found in places.values()) < _FEWEST:
        return []
    return [
        {name: found[min(test, len(found) - 1)] for name, found in places.items()} for test in range(*counts)
    ]


def _without_number(name: str) -> str:
    stem, unit = split_unit(name)
    return _NUMBER.sub("", stem).strip() + (f" [{unit}]" if unit else "")
