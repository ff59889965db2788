"""The one table of a batch: a row for each channel of each measurement."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from palpate.batches.measurements import BatchMeasurement
from palpate.estimation.kinds import Kind
from palpate.robot_io.errors import InputError, one_line
from palpate.robot_io.files.atomic_write import replace_undecodable
from palpate.robot_io.types import FloatArray
from palpate.sweep.case import ADDRESS

TABLE = "table"  # name of its files, without the ending
FIRST = ("measurement", "files", "group", "channel", "model", "verdict", "reason", "effects", "forms")
NUMBERS = ("unit", "samples", "runs", "rmse", "noise", "times_noise", "fits", "rmse_final", "excluded_share")
LAST = ("seconds", "warnings", "error", ADDRESS)
BUDGET = "budget "
EVERYTHING = "all"  # name of the group if no field defines groups
_KINDS = [*(kind.word for kind in Kind), "noise", "unexplained"]
_ENDS = (" low", " high", " std_err", " shrunk")


@dataclass(frozen=True)
class ParameterColumn:
    """A parameter of one channel, in all measurements that have it with a standard error."""

    channel: str  # its name
    name: str  # "effect.parameter"
    unit: str  # unit of the values
    rows: np.ndarray[Any, np.dtype[np.int64]]  # rows of the table, shape (n,)
    values: FloatArray  # shape (n,), in the unit
    std_errs: FloatArray  # shape (n,), in the unit

    @property
    def head(self) -> str:
        """The column of the values."""
        return head(self.name, self.unit)


def head(name: str, unit: str, end: str = "") -> str:
    """Return the name of a parameter's column.

    Args:
        name: "effect.parameter".
        unit: unit of the values.
        end: empty, or "low", "high", "std_err" or "shrunk".
    """
    return f"{name} {end} [{unit}]" if end else f"{name} [{unit}]"


def field_names(measurements: Sequence[BatchMeasurement], group: str | None) -> list[str]:
    """Return the names of all fields of the measurements.

    Args:
        measurements: measurements of the batch.
        group: field that tells groups apart; None for one group.

    Raises:
        InputError: a field has the name of a column of the table, or no measurement has the group's field.
    """
    fields = list(dict.fromkeys(name for each in measurements for name in each.fields))
    if taken := set(fields).intersection((*FIRST, *NUMBERS, *LAST)):
        raise InputError(
            f"field '{min(taken)}': the table already has a column with this name; rename the field"
        )
    if group is not None and group not in fields:
        raise InputError(f"--group {group}: no such field. Available: {', '.join(fields) or 'none'}")
    return fields


def make_table(
    measurements: Sequence[BatchMeasurement],
    addresses: Sequence[str | None],
    results: pa.Table,
    failures: Mapping[str, str],
    group: str | None,
) -> pa.Table:
    """Join names, fields and results; omit measurements with neither a result nor a failure.

    Args:
        measurements: measurements of the batch, m of them.
        addresses: addresses of their cases, m of them; None where a file cannot be read.
        results: rows of the cases, by address.
        failures: why a measurement has no result, by its name.
        group: field that tells groups apart; None for one group.

    Raises:
        InputError: see `field_names`.
    """
    fields = field_names(measurements, group)
    rows: dict[str, list[int]] = {}
    for row, address in enumerate(texts(results, ADDRESS)):
        rows.setdefault(address, []).append(row)
    # Each row of the table: number of its measurement, and row of the results; None where there is no result.
    places: list[tuple[int, int | None]] = []
    for number, measurement in enumerate(measurements):
        if own := rows.get(addresses[number] or ""):
            places += [(number, row) for row in own]
        elif measurement.name in failures:
            places.append((number, None))
    chosen = [measurements[number] for number, _ in places]
    columns = [name for name in results.column_names if name != ADDRESS]
    empty = [name for name in columns if results[name].null_count == len(results)]
    table = results.drop_columns(empty).take(pa.array([row for _, row in places], pa.int64()))
    known: dict[str, list[str | None]] = {
        "measurement": [each.name for each in chosen],
        "files": ["; ".join(each.files) for each in chosen],
        "group": [each.fields.get(group, "") if group else EVERYTHING for each in chosen],
        **{name: [each.fields.get(name) for each in chosen] for name in fields},
    }
    for name, cells in known.items():
        encodable = [cell if cell is None else replace_undecodable(cell) for cell in cells]
        table = table.append_column(name, pa.array(encodable, pa.string()))
    reasons = [replace_undecodable(failures.get(each.name, "")) or None for each in chosen]
    failed = pa.array(reasons, pa.string())
    if "error" in table.column_names:
        place = table.column_names.index("error")
        table = table.set_column(place, "error", pc.coalesce(table["error"], failed))
    else:
        table = table.append_column("error", failed)

    def sort_key(column: str) -> tuple[str, int]:
        """Return a sort key that keeps value, interval ends and standard error of a parameter together."""
        name, _, unit = column.rpartition(" [")
        end = next((end for end in _ENDS if name.endswith(end)), "")
        return f"{name.removesuffix(end)} [{unit}", (("", *_ENDS)).index(end)

    available = set(table.column_names) - {"seed", "first"}
    budget = [BUDGET + kind for kind in _KINDS]
    parameters = sorted(available.difference(FIRST, fields, NUMBERS, budget, LAST), key=sort_key)
    order = [*FIRST[:3], *fields, *FIRST[3:], *NUMBERS, *budget, *parameters, *LAST]
    return table.select([name for name in order if name in available])


def read_table(path: Path) -> pa.Table:
    """Read a table that a batch wrote, as Parquet or CSV.

    Args:
        path: path of the table, or of the batch's folder.

    Raises:
        InputError: it does not exist, or is not a table of a batch.
    """
    file = path / f"{TABLE}.parquet" if path.is_dir() else path
    if not file.is_file():  # a pipe might never end
        raise InputError(f"table {file}: cannot be read (there is no such regular file)")
    try:
        table = pq.read_table(file) if file.suffix == ".parquet" else pyarrow.csv.read_csv(file)
        names = set(table.column_names)
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        raise InputError(f"table {file}: cannot be read ({one_line(error)})") from error
    if not {"measurement", "channel"} <= names:
        raise InputError(
            f"table {file}: lacks the columns measurement and channel; make it with palpate batch"
        )
    for name in table.column_names:
        if table.column_names.count(name) > 1:
            raise InputError(f"table {file}: has the column '{one_line(name)[:60]}' twice")
        kind = table.schema.field(name).type
        if pa.types.is_nested(kind):
            raise InputError(f"table {file}: column '{one_line(name)[:60]}' holds {kind}, not single values")
    numeric = {"times_noise", *(column for column, *_ in _parameters(table))}
    numeric |= {head(name, unit, "std_err") for _, name, unit in _parameters(table)}
    for name in numeric.intersection(table.column_names):
        kind = table.schema.field(name).type
        if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind)):
            raise InputError(f"table {file}: column '{one_line(name)[:60]}' holds {kind}, expected numbers")
    return table


def _parameters(table: pa.Table) -> Iterator[tuple[str, str, str]]:
    """Column, name and unit of each parameter that has a column of standard errors."""
    for column in table.column_names:
        name, _, unit = column.removesuffix("]").rpartition(" [")
        is_value = column.endswith("]") and not name.endswith(_ENDS)
        if is_value and head(name, unit, "std_err") in table.column_names:
            yield column, name, unit


def parameter_columns(table: pa.Table) -> Iterator[ParameterColumn]:
    """Yield each parameter that at least one measurement has with a standard error, by channel.

    Args:
        table: table of a batch.
    """
    if "channel" not in table.column_names:
        return
    channel = table["channel"].to_numpy(zero_copy_only=False)
    for column, name, unit in _parameters(table):
        values, std_errs = (floats(table, each) for each in (column, head(name, unit, "std_err")))
        known = np.isfinite(values) & np.isfinite(std_errs) & (std_errs >= 0.0)
        for item in dict.fromkeys(channel[known]):
            rows = np.flatnonzero(known & (channel == item))
            yield ParameterColumn(item, name, unit, rows, values[rows], std_errs[rows])


def floats(table: pa.Table, name: str) -> FloatArray:
    """Return a column of numbers, shape (n,), with NaN for missing values.

    Args:
        table: table of a batch.
        name: name of the column.
    """
    if name not in table.column_names:
        return np.full(len(table), np.nan)
    numbers = pc.cast(table[name], pa.float64(), safe=False)
    return np.asarray(numbers.to_numpy(zero_copy_only=False), dtype=np.float64)


def texts(table: pa.Table, name: str) -> list[str]:
    """Return a column as text, with empty strings for missing values.

    Args:
        table: table of a batch.
        name: name of the column.
    """
    if name not in table.column_names:
        return [""] * len(table)
    return ["" if cell is None else str(cell) for cell in table[name].to_pylist()]
