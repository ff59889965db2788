"""One stream of a session, as arrays."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robot_io.errors import UnknownNameError
from robot_io.session.stream import RecordArray, Stream


@dataclass(frozen=True, eq=False)
class Samples:
    """The records of one stream as columns; all arrays are read-only."""

    stream: Stream  # name, units and meaning of the columns
    columns: Mapping[str, NDArray[Any]]  # each column, shape (n,) for a scalar or (n, width), in its unit

    @classmethod
    def of(cls, stream: Stream, columns: dict[str, NDArray[Any]]) -> "Samples":
        """Samples of columns that nobody else changes."""
        return cls(stream, _read_only(columns))

    @classmethod
    def from_records(cls, stream: Stream, records: RecordArray) -> "Samples":
        """Take the columns out of records of shape (n,)."""
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
        """A column as shape (n, width), also where the width is 1, as with an arm of one joint."""
        array = self[name]
        return array[:, np.newaxis] if array.ndim == 1 else array

    def select(self, chosen: ArrayLike) -> "Samples":
        """Some of the samples, by a mask of shape (n,) or by their indices."""
        index = np.asarray(chosen)
        return Samples(self.stream, _read_only({name: array[index] for name, array in self.columns.items()}))


def _read_only(columns: dict[str, NDArray[Any]]) -> Mapping[str, NDArray[Any]]:
    for array in columns.values():
        array.setflags(write=False)
    return MappingProxyType(columns)
