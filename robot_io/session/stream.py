"""What one stream of a session holds: named columns with units. The rest of its form follows from this."""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from robot_io.errors import InputError, SessionError

Record = tuple[object, ...] | np.void
RecordArray = NDArray[np.void]

TIME_COLUMN = "time_s"
DTYPES = ("float64", "float32", "int64", "int32", "uint64", "uint32", "bool")
MAX_COLUMNS = 1000
MAX_RECORD_BYTES = 16 * 1024  # several records fit into a chunk of 64 KiB

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")


@dataclass(frozen=True)
class Column:
    """One named quantity of a stream."""

    # Letters, digits and underscores; by custom with the unit and the frame ("tip_position_world_m").
    name: str
    unit: str  # such as "m", "N m", "rad/s"; "1" for a number without unit
    # 1 for a scalar, which is read back as shape (n,); more for a vector, read back as (n, width).
    width: int = 1
    doc: str = ""  # one line that says what it is, with its sign convention
    dtype: DTypeLike = "float64"  # one of `DTYPES`, or what numpy takes for one of them

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError(f"column name {self.name!r}: letters, digits and underscores, at most 64")
        if not 1 <= self.width <= MAX_RECORD_BYTES:
            raise InputError(f"column '{self.name}': width {self.width} is not in 1..{MAX_RECORD_BYTES}")
        try:
            name = np.dtype(self.dtype).name
        except TypeError as error:
            raise InputError(f"column '{self.name}': {self.dtype!r} is no type of number") from error
        if name not in DTYPES:
            raise InputError(f"column '{self.name}': type {name}; valid: {', '.join(DTYPES)}")
        object.__setattr__(self, "dtype", name)

    @property
    def scalar_dtype(self) -> np.dtype[Any]:
        """Type of one number, little endian as it is stored."""
        return np.dtype(self.dtype).newbyteorder("<")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one record's value: () or (width,)."""
        return () if self.width == 1 else (self.width,)


@dataclass(frozen=True)
class Stream:
    """A named sequence of records that all have the same columns.

    InputError: a name twice, no time, or a message of more than `MAX_RECORD_BYTES`.
    """

    name: str  # letters, digits and underscores
    # In the order of a record's values; one of them is the scalar float64 `time_s` [s].
    columns: tuple[Column, ...]
    # Records that a message of the session file holds, its last one perhaps less; a matter of the file only.
    batch: int = field(default=1, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        if not _NAME.fullmatch(self.name):
            raise InputError(f"stream name {self.name!r}: letters, digits and underscores, at most 64")
        names = [column.name for column in self.columns]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"stream '{self.name}': column {', '.join(twice)} is there twice")
        if not any(c.name == TIME_COLUMN and c.width == 1 and c.dtype == "float64" for c in self.columns):
            raise InputError(f"stream '{self.name}': needs a scalar float64 column '{TIME_COLUMN}'")
        if len(names) > MAX_COLUMNS:
            raise InputError(f"stream '{self.name}': {len(names)} columns, at most {MAX_COLUMNS}")
        if not isinstance(self.batch, int) or self.batch < 1:
            raise InputError(f"stream '{self.name}': {self.batch!r:.20} records in a message")
        if (size := self.batch * self.dtype.itemsize) > MAX_RECORD_BYTES:
            what = "a record" if self.batch == 1 else f"{self.batch} records"
            raise InputError(f"stream '{self.name}': {what} of {size} bytes, at most {MAX_RECORD_BYTES}")

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Structured type of one record, packed, in the order of the columns."""
        return np.dtype([(c.name, c.scalar_dtype, c.shape) for c in self.columns])

    def records(self, columns: Mapping[str, ArrayLike]) -> RecordArray:
        """Put whole columns together into records: a structured array of `dtype`, shape (n,).

        Each column is an array of shape (n,) or (n, width), all of the same length n.

        InputError: a column is missing, unknown, of another length or shape, or not a number.
        """
        arrays = self.arrays(columns)
        records = np.zeros(len(arrays[TIME_COLUMN]), self.dtype)
        for name, array in arrays.items():
            records[name] = array
        return records

    def arrays(self, columns: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
        """Whole columns as arrays that fit the stream; see `records`."""
        names = {column.name for column in self.columns}
        if names != set(columns):
            raise InputError(
                f"stream '{self.name}': columns missing: {sorted(names - set(columns))}, "
                f"unknown: {sorted(set(columns) - names)}"
            )
        count = np.shape(columns[TIME_COLUMN])[:1] or (1,)
        return {column.name: self._array(columns[column.name], column, count) for column in self.columns}

    def _array(self, values: ArrayLike, column: Column, count: tuple[int, ...]) -> NDArray[Any]:
        where = f"stream '{self.name}', column '{column.name}'"
        try:
            array = np.asarray(values)
        except ValueError as error:
            raise InputError(f"{where}: no rectangular array") from error
        if array.shape != count + column.shape:
            raise InputError(f"{where}: shape {array.shape}, expected {count + column.shape}")
        if not np.can_cast(array.dtype, column.scalar_dtype, casting="same_kind"):
            raise InputError(f"{where}: {array.dtype} does not fit {column.dtype}")
        return array


def streams_to_json(streams: tuple[Stream, ...]) -> str:
    """Describe streams as JSON text, as a session's header keeps them."""
    return json.dumps([asdict(stream) for stream in streams])


def streams_from_json(text: str) -> tuple[Stream, ...]:
    """Read back what `streams_to_json` wrote. SessionError: the text describes no valid streams."""
    try:
        return tuple(
            Stream(
                entry["name"], tuple(Column(**column) for column in entry["columns"]), entry.get("batch", 1)
            )
            for entry in json.loads(text)
        )
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise SessionError(f"the description of the streams is not valid: {error}") from error
