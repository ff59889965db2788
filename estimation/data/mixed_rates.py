"""Columns that were sampled at different rates into one table, with empty cells between."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa

from estimation.data.table import Table
from robot_io.errors import InputError

_SYSTEMATIC = 0.1  # of the cells: fewer that are empty are faults of the file
_SLOW = 2.0  # times the slowest one's rate, up to which an effort counts as slow
_SHARED = 0.5  # of the slowest column's values, that must stand beside values of all others


def with_one_rate(
    table: Table, time: str, efforts: Sequence[str], motions: Sequence[str], run: str | None
) -> tuple[Table, str]:
    """The rows in which all columns in use have a value, and a word on it; as it is where none is empty.

    Where hardly any row has them all, since each sensor wrote rows of its own, the others are read between
    their own samples at the times of an effort, whose noise must stay as it is, or of the slowest.

    Args:
        table: the rows.
        time: column of the times, which every row has.
        efforts: columns in use of forces and torques.
        motions: the other columns in use.
        run: column of the runs, or None.

    Raises:
        InputError: that cannot be, since runs or times are not in order.
    """
    names = (*efforts, *motions)
    there = {name: table.is_there(name) for name in names}
    some = {name: float(np.mean(mask)) for name, mask in there.items() if np.mean(mask) < 1.0 - _SYSTEMATIC}
    if not some:
        return table, ""
    slowest = min(some, key=lambda name: some[name])
    every = np.logical_and.reduce([there[name] for name in some])
    said = f"'{slowest}' has a value in {100.0 * some[slowest]:.2g} % of the rows"
    if np.sum(every) >= max(_SHARED * np.sum(there[slowest]), 1.0):
        return table.select(every), f"{said}: the rows that have them all are taken"
    if run is not None or not there[slowest].any() or (np.diff(times := table.numbers(time)) < 0.0).any():
        listed = ", ".join(map(repr, names))
        raise InputError(
            f"{table.path}: no row has all of {listed}; give each run a file of its own, in order of time"
        )
    base = next((name for name in efforts if some.get(name, 1.0) <= _SLOW * some[slowest]), slowest)
    columns, inside = table.columns, there[base].copy()
    for name in names:
        met = np.flatnonzero(there[name])
        inside[: met[0]] = inside[met[-1] + 1 :] = False
        if name != base:
            values = np.interp(times, times[met], table.select(there[name]).numbers(name))
            columns = columns.set_column(columns.column_names.index(name), name, pa.array(values))
    way = f"all others are read between their samples at the times of '{base}'"
    return replace(table, columns=columns).select(inside), f"{said}: {way}"
