"""Files and tables of arrays: Parquet, NPZ, and what is in memory."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from estimation.data.file_columns import FileColumns, check_size
from estimation.data.lerobot_table import flat_table, is_lerobot
from estimation.data.quantities import parse_role
from robot_io.errors import InputError

_LEAST_CELL = 4  # bytes of a value, of whatever type
_BATCH_ROWS = 256


def read_parquet(path: Path) -> FileColumns:
    """The columns of a Parquet file; arrays of a LeRobot data set element by element.

    Raises:
        InputError: it holds too much.
    """
    from pyarrow.parquet import ParquetFile  # noqa: PLC0415, slow to import

    with path.open("rb") as opened, ParquetFile(opened) as file:  # Arrow takes no name but UTF-8
        check_size(path, _LEAST_CELL * file.metadata.num_rows * file.metadata.num_columns)
        batches, size = [], 0
        for batch in file.iter_batches(_BATCH_ROWS, use_threads=False):  # what a row takes is known only then
            size += batch.nbytes
            check_size(path, size)
            batches.append(batch)
        table = pa.Table.from_batches(batches, file.schema_arrow)
    if not is_lerobot(table):
        return FileColumns(table)
    flat, words = flat_table(table, path)
    return FileColumns(flat, words=words)


def read_npz(path: Path) -> FileColumns:
    """The arrays of an NPZ file that are columns; objects are not unpickled.

    Raises:
        InputError: it holds too much, or arrays of objects or of different lengths.
    """
    with zipfile.ZipFile(path) as archive:
        check_size(path, sum(entry.file_size for entry in archive.infolist()))
    arrays = {}
    with np.load(path, allow_pickle=False) as archive:
        for name in archive.files:
            try:
                array = archive[name]
            except ValueError as error:
                reason = "holds objects, which might be code, and is not read; save it as numbers or text"
                raise InputError(f"{path}: column '{name}' {reason}") from error
            if array.ndim == 1 or parse_role(name):  # others, such as a sampling rate, are no columns
                arrays[name] = array
    return FileColumns(arrow_of(arrays, path))


def arrow_of(arrays: Mapping[str, NDArray[Any]], place: Path) -> pa.Table:
    """Arrays of numbers or text, by the names of their columns, as Arrow holds them.

    Raises:
        InputError: they are not all of one length, not one value a row, or not of real numbers or text.
    """
    for name, array in arrays.items():
        if array.ndim != 1:
            raise InputError(f"{place}: column '{name}' has shape {array.shape}, expected one value a row")
        if array.dtype.kind == "c":
            raise InputError(f"{place}: column '{name}' holds complex numbers, expected real ones")
    lengths = {name: len(array) for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise InputError(f"{place}: its columns have different lengths: {listed}")
    columns = {}
    for name, array in arrays.items():
        try:
            columns[name] = pa.array(array)
        except (pa.ArrowException, TypeError, ValueError, OverflowError) as error:
            kinds = ", ".join(sorted({type(value).__name__ for value in array.tolist()})[:3])
            raise InputError(
                f"{place}: column '{name}' holds values of type {kinds}, expected numbers or text"
            ) from error
    return pa.table(columns)
