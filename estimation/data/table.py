"""A file of measurements as named columns: CSV (also .gz), Parquet, or NPZ."""

import gzip
import os
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from robot_io.errors import InputError, UnknownNameError
from robot_io.types import BoolArray, FloatArray, IntArray

_DELIMITERS = (",", ";", "\t")
_LONGEST_LABEL = 60


@dataclass(frozen=True)
class Table:
    """Columns of equal length.

    Attributes:
        path: where they come from, for errors.
        columns: as Arrow holds them; those of a text file are text.
        rows: number of each row in the file, counted from 1 after the header, shape (n,).
    """

    path: Path
    columns: pa.Table
    rows: IntArray

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in their order."""
        return tuple(self.columns.column_names)

    def numbers(self, name: str) -> FloatArray:
        """A column of numbers, shape (n,).

        Raises:
            InputError: there is no such column, or a value is missing or no finite number.
        """
        column = self._column(name)
        try:
            values = np.asarray(_as_numbers(column).to_numpy(zero_copy_only=False), dtype=np.float64)
        except (pa.ArrowException, TypeError, ValueError):
            values = np.array([_number_or_nan(text) for text in column.to_pylist()], dtype=np.float64)
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            shown = str(column[int(bad[0])].as_py())[:_LONGEST_LABEL]
            more = f" ({len(bad) - 1} more like it)" if len(bad) > 1 else ""
            raise InputError(
                f"{self.path}: row {self.rows[bad[0]]}, column '{name}': {shown!r} is no finite number{more}"
                "; remove such rows, or choose others with --where"
            )
        return values

    def labels(self, name: str) -> NDArray[np.str_]:
        """A column as text, shape (n,).

        Raises:
            InputError: there is no such column.
        """
        return np.array([_text(value) for value in self._column(name).to_pylist()], dtype=np.str_)

    def select(self, chosen: BoolArray) -> "Table":
        """The table with only these rows, mask of shape (n,)."""
        return Table(self.path, self.columns.filter(pa.array(chosen)), self.rows[chosen])

    def _column(self, name: str) -> pa.ChunkedArray:
        if name not in self.names:
            close = get_close_matches(name, self.names, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise UnknownNameError(
                f"{self.path}: no column '{name}'{hint} There are: {', '.join(self.names)}"
            )
        return self.columns.column(name)


def read_table(path: str | os.PathLike[str]) -> Table:
    """Open a data file by the ending of its name.

    Raises:
        InputError: it cannot be read, is empty, or is of no known kind.
    """
    place = Path(path)
    if not place.is_file():
        raise InputError(f"{place}: no such file")
    ending = Path(place.name.lower().removesuffix(".gz")).suffix
    read = next((reader for endings, reader in _READERS if ending in endings), None)
    if read is None:
        known = ", ".join(known for endings, _ in _READERS for known in endings)
        raise InputError(
            f"{place}: unknown kind of file. Valid: {known}; a text file may be packed, as .csv.gz"
        )
    try:
        found = read(place)
        names = [" ".join(name.split()) for name in found.column_names]
        columns = found.rename_columns(names)
    except InputError:
        raise
    except Exception as error:  # a broken file can make the libraries raise almost anything
        raise InputError(f"{place}: cannot be read: {' '.join(str(error).split())[:200]}") from error
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{place}: column {', '.join(map(repr, twice))} is there twice; rename one")
    if columns.num_rows == 0:
        raise InputError(f"{place}: no rows of data")
    return Table(place, columns, np.arange(1, columns.num_rows + 1))


def _read_text(path: Path) -> pa.Table:
    open_text = gzip.open if path.name.lower().endswith(".gz") else open
    with open_text(path, "rt", encoding="utf-8-sig", newline="") as file:
        header = file.readline().rstrip("\r\n")
    delimiter = max(_DELIMITERS, key=header.count)
    names = [name.strip().strip('"') for name in header.split(delimiter)]
    if all(not np.isnan(_number_or_nan(name)) for name in names):
        raise InputError(f"{path}: the first line holds numbers; put the names of the columns there")
    return pa.csv.read_csv(
        path,
        read_options=pa.csv.ReadOptions(column_names=names, skip_rows=1),
        parse_options=pa.csv.ParseOptions(delimiter=delimiter),
        convert_options=pa.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
    )


def _read_parquet(path: Path) -> pa.Table:
    return pa.parquet.read_table(path)


def _read_npz(path: Path) -> pa.Table:
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    flat = {name: array for name, array in arrays.items() if array.ndim == 1}
    lengths = {name: len(array) for name, array in flat.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(f"{path}: its arrays have different lengths: {lengths}")
    return pa.table(flat)


def _as_numbers(column: pa.ChunkedArray) -> pa.ChunkedArray:
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        return pc.cast(pc.utf8_trim_whitespace(column), pa.float64())
    return pc.cast(column, pa.float64())


def _number_or_nan(text: object) -> float:
    try:
        return float(str(text).strip())
    except ValueError:
        return float("nan")


def _text(value: object) -> str:
    """Text of a value; whole numbers without decimal point, so that runs read the same in every format."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return " ".join(str(value).split())[:_LONGEST_LABEL]


_READERS: tuple[tuple[tuple[str, ...], Callable[[Path], pa.Table]], ...] = (
    ((".csv", ".tsv", ".txt"), _read_text),
    ((".parquet", ".pq"), _read_parquet),
    ((".npz",), _read_npz),
)
