"""Measurements whose numbers are degenerate, or none."""

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from files_under_fire.case import Case, Rng, pick
from robot_io import Session

NAMES = ("time_s", "displacement_m", "force_N")
CELLS = (
    *("nan", "inf", "-inf", "1e400", "-1e400", "1e-400", "0x10", "1_000", "\u0661\u0662", "\uff11\uff12"),
    *("+-1", "", " ", "--", "1.2.3", "1,5", "1e", "\u221e", "NULL", "-0", "1d5", "true", "1e30", "1e200"),
    *("9" * 400, "\x1b[2J"),
)


def case(folder: Path, rng: Rng) -> Case:
    """A file of degenerate measurements and a command for it."""
    columns = presses(rng)
    kind = pick(rng, tuple(_CHANGES))
    _CHANGES[kind](columns, rng)
    path, session = folder / pick(rng, ("a.csv", "a.csv", "a.csv", "a.parquet", "a.npz")), folder / "a.mcap"
    _write(path, columns, rng)
    command = pick(rng, ("import", "import", "estimate", "compare", "diagnose"))
    options = ["-o", str(session)] if command == "import" else ["--model", "kelvin_voigt"]
    return Case(
        f"{kind}, {path.suffix}, {command}",
        [command, str(path), *options],
        lambda: _differs(path, session) if session.exists() else "",
    )


def presses(rng: Rng) -> dict[str, list[Any]]:
    """Two short presses at 100 Hz, as numbers."""
    time_s = np.arange(240) * 0.01
    depth_m = 0.004 * np.sin(2 * np.pi * time_s / 1.2) + 1e-6 * rng.standard_normal(len(time_s))
    force_n = np.maximum(500 * depth_m, 0.0) + 0.01 * rng.standard_normal(len(time_s))
    values = (time_s.round(3), depth_m.round(7), force_n.round(4))
    return {name: column.tolist() for name, column in zip(NAMES, values, strict=True)}


def _differs(path: Path, session: Path) -> str:
    """What was stored otherwise than the format's own reader finds it in the file; empty if nothing was."""
    rows = _rows_of(path)
    rows.sort(key=lambda row: row.get("run", ""))  # a run's samples are stored together
    stored = Session.open(session).samples("contact")
    for name, column in zip(NAMES, ("time_s", "displacement_m", "force_n"), strict=True):
        cells = [row[name] or "" for row in rows if all((row[one] or "").strip() for one in NAMES)]
        numbers = [_number(cell) for cell in cells]
        if any(math.isnan(number) for number in numbers):
            return f"{name} holds {cells[[math.isnan(n) for n in numbers].index(True)]!r} and was taken"
        if len(numbers) != len(stored[column]):
            return f"{len(numbers)} rows stand there, {len(stored[column])} were taken"
        if not np.allclose(np.abs(numbers), np.abs(stored[column]), rtol=1e-12, atol=0.0):
            return f"{name} was taken as something else"
    return ""


def _rows_of(path: Path) -> list[dict[str, str]]:
    """The rows, with each cell as text."""
    if path.suffix == ".csv":
        with path.open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    if path.suffix == ".npz":
        with np.load(path) as archive:
            columns = {name: archive[name].tolist() for name in archive.files}
    else:
        columns = pa.parquet.read_table(path).to_pydict()
    texts = {name: list(map(_text, values)) for name, values in columns.items()}
    return [dict(zip(texts, row, strict=True)) for row in zip(*texts.values(), strict=True)]


def _text(value: Any) -> str:  # noqa: ANN401
    if isinstance(value, list):
        (value,) = value
    return "" if value is None else str(value)


def _number(cell: str) -> float:
    try:
        number = math.nan if "_" in cell else float(cell)  # digits of any script are digits
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def _write(path: Path, columns: dict[str, list[Any]], rng: Rng) -> None:
    if path.suffix == ".csv":
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
        return
    arrays = {name: _array(values, rng) for name, values in columns.items()}
    if path.suffix == ".npz":
        np.savez(path, **arrays)
        return
    pa.parquet.write_table(pa.table({name: _arrow(array, rng) for name, array in arrays.items()}), path)


def _array(values: list[Any], rng: Rng) -> np.ndarray[Any, Any]:
    kind = pick(rng, ("f8", "f8", "f8", "f4", "f2", "i8", "U30", "c16", "O", "?"))
    try:
        with np.errstate(all="ignore"):
            return np.array(values).astype(kind)
    except (ValueError, TypeError, OverflowError):
        return np.array([str(value) for value in values])


def _arrow(array: np.ndarray[Any, Any], rng: Rng) -> pa.Array:
    values = array.tolist() if array.dtype.kind in "OU?" else np.abs(array).astype(float).tolist()
    kinds = (
        None,
        pa.decimal128(30, 6),
        pa.string(),
        pa.list_(pa.float64(), 1),
        pa.timestamp("us"),
        pa.int8(),
    )
    kind = pick(rng, kinds)
    try:
        if kind is not None and pa.types.is_fixed_size_list(kind):
            values = [[value] for value in values]
        return pa.array(values, kind)
    except (pa.ArrowException, TypeError, ValueError, OverflowError):
        return pa.array([str(value) for value in values])


def _cells(columns: dict[str, list[Any]], rng: Rng) -> None:
    column, count = columns[pick(rng, NAMES)], int(pick(rng, (1, 3, 50, 240)))
    cell = pick(rng, CELLS)
    for row in rng.integers(len(column), size=count) if count < len(column) else range(len(column)):
        column[row] = cell


def _scaled(columns: dict[str, list[Any]], rng: Rng) -> None:
    name, factor = pick(rng, NAMES), pick(rng, (0.0, 1e300, 1e-300, 1e-310, -1.0, 1e9, 1e-9, 1e30, 1e155))
    columns[name] = [factor * value for value in columns[name]]


def _shifted(columns: dict[str, list[Any]], rng: Rng) -> None:
    name, by = pick(rng, NAMES), pick(rng, (1e9, -1e9, 1e16, 1e-5, -5.0, 1e300))
    columns[name] = [by + value for value in columns[name]]


def _rounded(columns: dict[str, list[Any]], rng: Rng) -> None:
    name, digits = pick(rng, NAMES), int(rng.integers(-1, 4))
    columns[name] = [round(value, digits) for value in columns[name]]


def _rows(columns: dict[str, list[Any]], rng: Rng) -> None:
    count = len(columns["time_s"])
    few = int(pick(rng, (0, 1, 2, 4, 5, 6, 10, 20)))
    chosen = pick(
        rng, (np.arange(few), rng.permutation(count), np.arange(count)[::-1], np.repeat(np.arange(count), 2))
    )
    columns.update({name: [values[row] for row in chosen] for name, values in columns.items()})


def _same(columns: dict[str, list[Any]], rng: Rng) -> None:
    one, other = pick(rng, NAMES), pick(rng, NAMES)
    columns[one] = list(columns[other])


def _runs(columns: dict[str, list[Any]], rng: Rng) -> None:
    count = len(columns["time_s"])
    some = (list(range(count)), [7] * count, ["a", "b"] * (count // 2), [""] * count, [10**30] * count)
    columns["run"] = pick(rng, (*some, [float("nan")] * count, [n // 120 for n in range(count)]))


def _others(columns: dict[str, list[Any]], rng: Rng) -> None:
    name = pick(rng, ("velocity_m_s", "acceleration_m_s2", "phase", "temperature", "velocity"))
    columns[name] = rng.standard_normal(len(columns["time_s"])).tolist()


_CHANGES: dict[str, Callable[[dict[str, list[Any]], Rng], None]] = {
    "cells": _cells,
    "cells again": _cells,
    "scaled": _scaled,
    "shifted": _shifted,
    "rounded": _rounded,
    "rows": _rows,
    "same columns": _same,
    "runs": _runs,
    "other columns": _others,
}
