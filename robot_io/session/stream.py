"""Streams of a session: named columns with units, and their samples as arrays."""

import json
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from difflib import get_close_matches
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from palpate.robot_io.errors import InputError, SessionError, UnknownNameError

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
    doc: str = ""  # one line: its meaning and sign convention
    dtype: DTypeLike = "float64"  # one of `DTYPES`, or what numpy takes for one of them

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError(f"column name {self.name!r}: use at most 64 letters, digits and underscores")
        if not 1 <= self.width <= MAX_RECORD_BYTES:
            raise InputError(f"column '{self.name}': width {self.width} is not in 1..{MAX_RECORD_BYTES}")
        try:
            name = np.dtype(self.dtype).name
        except TypeError as error:
            raise InputError(f"column '{self.name}': {self.dtype!r} is not a numeric type") from error
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

    Raises:
        InputError: a name appears twice, there is no time, or a message exceeds `MAX_RECORD_BYTES`.
    """

    name: str  # letters, digits and underscores
    # In the order of a record's values; one of them is the scalar float64 `time_s` [s].
    columns: tuple[Column, ...]
    # Records that a message of the session file holds, its last one perhaps less; a matter of the file only.
    batch: int = field(default=1, compare=False)

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError(f"stream name {self.name!r}: use at most 64 letters, digits and underscores")
        names = [column.name for column in self.columns]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"stream '{self.name}': column {', '.join(twice)} appears twice")
        if not any(c.name == TIME_COLUMN and c.width == 1 and c.dtype == "float64" for c in self.columns):
            raise InputError(f"stream '{self.name}': needs a scalar float64 column '{TIME_COLUMN}'")
        if len(names) > MAX_COLUMNS:
            raise InputError(f"stream '{self.name}': {len(names)} columns, at most {MAX_COLUMNS}")
        if not isinstance(self.batch, int) or self.batch < 1:
            raise InputError(f"stream '{self.name}': batch {self.batch!r:.20} must be a positive integer")
        if (size := self.batch * self.dtype.itemsize) > MAX_RECORD_BYTES:
            what = "a record" if self.batch == 1 else f"{self.batch} records"
            raise InputError(f"stream '{self.name}': {what} of {size} bytes, at most {MAX_RECORD_BYTES}")

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Structured type of one record, packed, in the order of the columns."""
        return np.dtype([(c.name, c.scalar_dtype, c.shape) for c in self.columns])

    def records(self, columns: Mapping[str, ArrayLike]) -> RecordArray:
        """Combine columns into records of `dtype`, shape (n,).

        Args:
            columns: arrays of shape (n,) or (n, width), all of the same length n.

        Raises:
            InputError: a column is missing, unknown, of a wrong length or shape, or not a number.
        """
        arrays = self.arrays(columns)
        records = np.zeros(len(arrays[TIME_COLUMN]), self.dtype)
        for name, array in arrays.items():
            records[name] = array
        return records

    def arrays(self, columns: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
        """Convert columns to arrays that fit the stream; raise `InputError` as `records` does.

        Args:
            columns: columns as for `records`.
        """
        names = {column.name for column in self.columns}
        if names != set(columns):
            raise InputError(
                f"stream '{self.name}': columns missing: {sorted(names - set(columns))}, "
                f"unknown: {sorted(set(columns) - names)}"
            )
        count = np.shape(columns[TIME_COLUMN])[:1] or (1,)
        arrays: dict[str, NDArray[Any]] = {}
        for column in self.columns:
            where = f"stream '{self.name}', column '{column.name}'"
            try:
                array = arrays[column.name] = np.asarray(columns[column.name])
            except ValueError as error:
                raise InputError(f"{where}: not a rectangular array") from error
            if array.shape != count + column.shape:
                raise InputError(f"{where}: shape {array.shape}, expected {count + column.shape}")
            if not np.can_cast(array.dtype, column.scalar_dtype, casting="same_kind"):
                raise InputError(f"{where}: {array.dtype} does not fit {column.dtype}")
        return arrays


def streams_to_json(streams: tuple[Stream, ...]) -> str:
    """Describe streams as JSON text, as a session's header keeps them."""
    return json.dumps([asdict(stream) for stream in streams])


def streams_from_json(text: str) -> tuple[Stream, ...]:
    """Read what `streams_to_json` wrote; raise `SessionError` if it describes no valid streams.

    Args:
        text: JSON.
    """
    try:
        return tuple(
            Stream(
                entry["name"], tuple(Column(**column) for column in entry["columns"]), entry.get("batch", 1)
            )
            for entry in json.loads(text)
        )
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise SessionError(f"the description of the streams is not valid: {error}") from error


@dataclass(frozen=True, eq=False)
class Samples:
    """The records of one stream as columns; all arrays are read-only."""

    stream: Stream  # name, units and meaning of the columns
    columns: Mapping[str, NDArray[Any]]  # each column, shape (n,) for a scalar or (n, width), in its unit

    @classmethod
    def of(cls, stream: Stream, columns: dict[str, NDArray[Any]]) -> "Samples":
        """Make samples from columns, which no other code may change.

        Args:
            stream: stream of the columns.
            columns: arrays of shape (n,) or (n, width).
        """
        for array in columns.values():
            array.setflags(write=False)
        return cls(stream, MappingProxyType(columns))

    @classmethod
    def from_records(cls, stream: Stream, records: RecordArray) -> "Samples":
        """Split records into columns.

        Args:
            stream: stream of the records.
            records: shape (n,).
        """
        return cls.of(stream, {c.name: records[c.name].astype(c.dtype) for c in stream.columns})

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __getitem__(self, name: str) -> NDArray[Any]:
        try:
            return self.columns[name]
        except KeyError:
            close = get_close_matches(name, self.columns, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise UnknownNameError(
                f"stream '{self.stream.name}' has no column '{name}'{hint} Valid: {', '.join(self.columns)}"
            ) from None

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        return {column.name: column.unit for column in self.stream.columns}

    def vector(self, name: str) -> NDArray[Any]:
        """Return a column as shape (n, width), even if the width is 1, as with an arm of one joint."""
        array = self[name]
        return array[:, np.newaxis] if array.ndim == 1 else array

    def select(self, chosen: ArrayLike | slice, names: Collection[str] | None = None) -> "Samples":
        """Select some of the samples.

        Args:
            chosen: mask of shape (n,), indices, or a slice, which copies nothing.
            names: columns to keep, of those that are there; None for all.
        """
        index = chosen if isinstance(chosen, slice) else np.asarray(chosen)
        kept = [name for name in self.columns if names is None or name in names]
        return Samples.of(self.stream, {name: self.columns[name][index] for name in kept})
