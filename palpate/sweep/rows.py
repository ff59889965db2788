"""Rows of a sweep's results: their groups, and the errors of the estimates in them."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from palpate.robot_io.errors import InputError, one_line
from palpate.robot_io.types import FloatArray
from palpate.runs.hidden_effects import SURFACE
from palpate.sweep.case import Row

TRUE, BOUND, LOW, HIGH = "true ", "bound ", "low ", "high "
T = TypeVar("T")


@dataclass(frozen=True)
class SweepTable:
    """Table that is printed, and written as CSV."""

    name: str  # name of the CSV file, without its extension
    title: str  # title of the table
    columns: tuple[str, ...]  # column headings
    rows: tuple[tuple[Any, ...], ...]  # cells, text or numbers


@dataclass(frozen=True)
class EstimationErrors:
    """Errors of one estimator for one parameter, from all rows with both estimate and truth."""

    relative: FloatArray  # estimate / truth - 1, shape (m,), of the rows with nonzero truth
    at_zero: FloatArray  # estimates of the rows with zero truth, shape (z,)
    over_bound: float  # root mean square of error / Cramer-Rao bound; NaN without a bound
    covered: float  # share of the 95 % intervals that contain the truth; NaN without intervals


def errors_of(rows: Iterable[Row], parameter: str) -> EstimationErrors:
    """Collect the errors of a parameter, such as "stiffness.k".

    Args:
        rows: rows of one or several cases.
        parameter: name of the parameter.
    """
    known = [row for row in rows if row.get(parameter) is not None and row.get(TRUE + parameter) is not None]
    estimated, true = column(known, parameter), column(known, TRUE + parameter)
    bound, error = column(known, BOUND + parameter), estimated - true
    low, high = column(known, LOW + parameter), column(known, HIGH + parameter)
    stated = np.isfinite(low) & np.isfinite(high)
    inside = (low <= true) & (true <= high)
    some = true != 0
    usable = np.isfinite(bound) & (bound > 0)
    ratio = float(np.sqrt(np.mean((error[usable] / bound[usable]) ** 2))) if usable.any() else float("nan")
    covered = float(np.mean(inside[stated])) if stated.any() else float("nan")
    return EstimationErrors(error[some] / true[some], estimated[~some], ratio, covered)


def column(rows: Sequence[Row], name: str) -> FloatArray:
    """Return a column's values, shape (n,), NaN where missing; raise `InputError` if one is not a number.

    Args:
        rows: rows of any cases.
        name: name of the column.
    """
    values = [np.nan if row.get(name) is None else row[name] for row in rows]
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(
                f"results: '{one_line(name)}' is {one_line(value)[:40]!r}, which is not a number"
            )
    return np.array(values, dtype=np.float64)


def parameters_of(rows: Sequence[Row]) -> list[str]:
    """Return the estimated parameters with known true values, except the surface.

    Args:
        rows: rows of any cases.
    """
    names = dict.fromkeys(key.removeprefix(TRUE) for row in rows for key in row if key.startswith(TRUE))
    names.pop(SURFACE, None)
    return [name for name in names if any(row.get(name) is not None for row in rows)]


def grouped(rows: Iterable[T], key: Callable[[T], Hashable]) -> dict[Any, list[T]]:
    """Group rows by a key, in order of first appearance.

    Args:
        rows: items to group.
        key: returns the key of an item.
    """
    groups: dict[Any, list[T]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def estimated(rows: Iterable[Row]) -> list[Row]:
    """Select the rows in which an estimator had a result.

    Args:
        rows: rows of any cases.
    """
    return [row for row in rows if row.get("estimator") and not row.get("problem") and not row["error"]]


def error_table(name: str, title: str, rows: Sequence[Row], best_first: bool = False) -> SweepTable:
    """Tabulate worst and mean error, ratio to the bound, and coverage, for each estimator and parameter.

    Args:
        name: name of the table's file.
        title: title above the table.
        rows: rows of any cases.
        best_first: whether to sort by the worst error rather than by name.
    """
    parameters = parameters_of(rows)
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
