"""What the rows of a sweep say of each estimator: errors, over the bound as well, and coverage."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from palpate.sweep.case import Row
from robot_io.errors import InputError
from robot_io.files.file_model import one_line
from robot_io.types import FloatArray

TRUE, BOUND, LOW, HIGH = "true ", "bound ", "low ", "high "
SURFACE = "surface"
T = TypeVar("T")


@dataclass(frozen=True)
class SweepTable:
    """A table as it is printed, and written as CSV."""

    name: str  # of its CSV file, without the ending
    title: str  # what it shows
    columns: tuple[str, ...]  # heads
    rows: tuple[tuple[Any, ...], ...]  # cells, text or numbers


@dataclass(frozen=True)
class Errors:
    """Errors of one parameter by one estimator, from all rows in which both are known."""

    relative: FloatArray  # estimate over truth, less one, shape (m,); only where the truth is not zero
    at_zero: FloatArray  # estimates where it is, shape (z,)
    over_bound: float  # root mean square of error over Cramer-Rao bound; NaN where there is none
    covered: float  # share of the 95 % intervals that hold the truth; NaN where none is stated


def errors_of(rows: Iterable[Row], parameter: str) -> Errors:
    """The errors of a parameter, such as "stiffness.k"."""
    known = [row for row in rows if row.get(parameter) is not None and row.get(TRUE + parameter) is not None]
    found, true = column(known, parameter), column(known, TRUE + parameter)
    bound, error = column(known, BOUND + parameter), found - true
    low, high = column(known, LOW + parameter), column(known, HIGH + parameter)
    stated = np.isfinite(low) & np.isfinite(high)
    inside = (low <= true) & (true <= high)
    some = true != 0
    usable = np.isfinite(bound) & (bound > 0)
    return Errors(
        error[some] / true[some],
        found[~some],
        float(np.sqrt(np.mean((error[usable] / bound[usable]) ** 2))) if usable.any() else float("nan"),
        float(np.mean(inside[stated])) if stated.any() else float("nan"),
    )


def column(rows: Sequence[Row], name: str) -> FloatArray:
    """Values of one column, shape (n,); NaN where a row has none. InputError: one is not a number."""
    values = [np.nan if row.get(name) is None else row[name] for row in rows]
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"results: '{one_line(name)}' is {one_line(value)[:40]!r}, which is no number")
    return np.array(values, dtype=np.float64)


def parameters_of(rows: Iterable[Row]) -> list[str]:
    """Names of the parameters of which the truth is known, the surface aside."""
    names = dict.fromkeys(key.removeprefix(TRUE) for row in rows for key in row if key.startswith(TRUE))
    return [name for name in names if name != SURFACE]


def grouped(rows: Iterable[T], key: Callable[[T], Hashable]) -> dict[Any, list[T]]:
    """Rows by a key, in the order in which the keys come."""
    groups: dict[Any, list[T]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def estimated(rows: Iterable[Row]) -> list[Row]:
    """Those rows in which an estimator had an answer."""
    return [row for row in rows if row.get("estimator") and not row.get("problem") and not row["error"]]


def error_table(name: str, title: str, rows: Sequence[Row], best_first: bool = False) -> SweepTable:
    """One line for each estimator: worst and mean error, over the bound, and coverage, of each parameter."""
    parameters = [p for p in parameters_of(rows) if any(row.get(p) is not None for row in rows)]
    lines = []
    for estimator, own in grouped(estimated(rows), lambda row: row["estimator"]).items():
        cells: list[Any] = [estimator]
        for parameter in parameters:
            errors = errors_of(own, parameter)
            relative = 100 * np.abs(errors.relative)
            cells += [float(relative.max()), float(np.mean(relative))] if len(relative) else [None, None]
            cells += [errors.over_bound, 100 * errors.covered]
        failed = sum(row.get("estimator") == estimator and bool(row.get("problem")) for row in rows)
        lines.append((*cells, failed))
    if best_first:
        lines.sort(key=lambda line: line[1] if line[1] is not None else np.inf)
    short = [name.split(".")[-1] for name in parameters]
    called = short if len(set(short)) == len(short) else parameters
    figures = ("worst %", "mean %", "over bound", "in 95 % interval, %")
    heads = [f"{name}: {figure}" for name in called for figure in figures]
    return SweepTable(name, title, ("estimator", *heads, "no answer"), tuple(lines))
