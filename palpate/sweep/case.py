"""Cases of a sweep, their content addresses and stored results.

The address is the SHA-256 of everything that determines the result: the work function, the parameters, the
seed, and the code. A stored result is therefore never computed again, and no old result is used after a
change of the code.
"""

import importlib
import importlib.util
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any
from uuid import uuid4

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from palpate.common.failures import make_folder
from palpate.robot_io.errors import InputError, one_line

Row = dict[str, Any]
TaskFunction = Callable[[Mapping[str, Any], int], list[Row]]
"""Function of parameters and seed that returns rows of scalars; equal arguments give equal rows."""

_PHYSICS = ("palpate.robot_io", "palpate.control", "palpate.estimation", "palpate.sim_backend")
_LIBRARIES = ("numpy", "scipy", "pin", "pybullet", "mujoco-core")
_ENDINGS = {".py", ".urdf", ".yaml"}


@dataclass(frozen=True)
class Case:
    """One case."""

    task: str  # "package.module:function", a `TaskFunction`
    parameters: Mapping[str, Any]  # JSON data; its text is part of the address
    seed: int = 0  # seed of all random numbers

    @property
    def address(self) -> str:
        """Content address of the result, 64 hexadecimal digits."""
        parts = [self.task, self.parameters, self.seed, code_version(self.task.partition(":")[0])]
        return sha256(json.dumps(parts, sort_keys=True, allow_nan=False).encode()).hexdigest()

    @property
    def label(self) -> str:
        """Name of the case in error messages."""
        return f"case {dict(self.parameters)}"

    def check(self) -> None:
        """Raise `PalpateError` if an input besides the parameters is missing; the case then has no result."""

    def run(self) -> list[Row]:
        """Run the case; exceptions of the work function propagate."""
        module, _, function = self.task.partition(":")
        task: TaskFunction = getattr(importlib.import_module(module), function)
        return task(self.parameters, self.seed)


@cache
def code_version(module: str) -> str:
    """Return the SHA-256 of the code that determines results: palpate's physics, the work and the libraries.

    Args:
        module: import name of the work's module.

    Raises:
        InputError: there is no such module.
    """
    versions = dict.fromkeys(_LIBRARIES, "not installed")
    for name in _LIBRARIES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    digest = sha256("".join(f"{name} {installed}\n" for name, installed in versions.items()).encode())
    for folder in (*map(_folder_of, _PHYSICS), _folder_of(module)):
        for path in sorted(folder.rglob("*")):
            if path.suffix in _ENDINGS and path.is_file():
                digest.update(f"{folder.name}/{path.relative_to(folder).as_posix()}\0".encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()


def _folder_of(module: str) -> Path:
    spec = importlib.util.find_spec(module)
    if spec is not None and spec.submodule_search_locations:  # a package, with or without an __init__.py
        return Path(next(iter(spec.submodule_search_locations)))
    if spec is None or spec.origin is None:
        raise InputError(f"work module '{module}': Python does not find it")
    return Path(spec.origin).parent


RESULTS = "results"  # subfolder of an output folder


def refuse_other_files(folder: Path) -> None:
    """Raise `InputError` if an output folder holds files, but no results of an earlier call.

    Args:
        folder: folder from the user; it need not exist yet.
    """
    if folder.is_dir() and any(folder.iterdir()) and not (folder / RESULTS).is_dir():
        raise InputError(f"output folder {folder}: holds other files; choose another")


ADDRESS = "address"
_PACK = "pack-"
_ENDING = ".parquet"
_SECONDS = "seconds"  # column of a case's processor time
_MOST_ROWS = 10_000_000
_TOGETHER = 50  # single files that are in memory at once; a table of one row takes more than 100 kB
_ROUNDING = 1e-6  # relative difference that is tolerated between machines


class ResultStore:
    """Stored results of one sweep.

    Args:
        folder: folder of the results, created if needed.

    Raises:
        InputError: the folder cannot be created.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            make_folder(folder)
        except OSError as error:
            raise InputError(f"results folder {folder}: cannot be created ({error.strerror})") from error

    def write(self, address: str, rows: Sequence[Row]) -> None:
        """Store the rows of one case.

        Args:
            address: address of the case, the name of its file.
            rows: its rows, at least one.

        Raises:
            OSError: they cannot be written.
        """
        table = pa.Table.from_pylist([{ADDRESS: address} | row for row in rows])
        _write(self.folder / f"{address}{_ENDING}", table)

    def finished(self) -> set[str]:
        """Return the addresses of all stored results; raise `InputError` if a file is damaged."""
        addresses: set[str] = set()
        for _, part in self._tables([ADDRESS]):
            addresses.update(part[ADDRESS].to_pylist())
        return addresses

    def rows(self, addresses: Iterable[str]) -> list[Row]:
        """Return rows of these cases, in order, without unfinished cases and without values of None.

        A pack has the columns of all its cases; columns that a case does not have are None.

        Args:
            addresses: addresses of the cases.

        Raises:
            InputError: a file is damaged, or two of them disagree about a case.
        """
        kept: dict[str, list[Row]] = {address: [] for address in addresses}
        for path, part in self._tables():
            new: dict[str, list[Row]] = {}
            for row in part.to_pylist():
                known = {name: value for name, value in row.items() if value is not None}
                new.setdefault(known.pop(ADDRESS), []).append(known)
            for address, rows in new.items():
                if kept.get(address) and not _agree(kept[address], rows):
                    raise _damaged(path, f"another file has a different result for case {address[:12]}...")
                if address in kept:
                    kept[address] = rows
        return [row for rows in kept.values() for row in rows]

    def table(self, addresses: Iterable[str]) -> pa.Table:
        """Return rows of these cases as one Arrow table, each with its `ADDRESS`.

        Args:
            addresses: addresses of the cases.

        Raises:
            InputError: a file is damaged.
        """
        missing, parts = set(addresses), dict[Path, pa.Table]()
        for path, part in self._tables():
            new = missing.intersection(part[ADDRESS].unique().to_pylist())
            parts[path] = part.filter(pc.is_in(part[ADDRESS], pa.array(new, pa.string())))
            missing -= new
        return _joined(parts)

    def drop(self, addresses: Iterable[str]) -> None:
        """Delete the results of these cases.

        Args:
            addresses: addresses of the cases; unknown ones are ignored.

        Raises:
            InputError: a file is damaged.
        """
        dropped = pa.array(list(addresses), pa.string())
        for path, part in self._tables():
            left = part.filter(pc.invert(pc.is_in(part[ADDRESS], dropped)))
            if not len(left):
                path.unlink()
            elif len(left) < len(part):
                _write(path, left)

    def pack(self) -> None:
        """Merge all single files into a new pack."""
        landed = self._unpacked()
        if len(landed) < 2:
            return
        groups = [landed[first : first + _TOGETHER] for first in range(0, len(landed), _TOGETHER)]
        table = _joined(
            {each[0]: _joined({path: _read(path) for path in each}).combine_chunks() for each in groups}
        )
        _write(self.folder / f"{_PACK}{uuid4().hex}{_ENDING}", table)
        for path in landed:
            path.unlink(missing_ok=True)

    def _unpacked(self) -> list[Path]:
        return sorted(
            path for path in self.folder.glob(f"*{_ENDING}") if not path.name.startswith((_PACK, "."))
        )

    def _tables(self, columns: list[str] | None = None) -> Iterator[tuple[Path, pa.Table]]:
        """Yield each file with its rows, packs first; raise `InputError` if one is damaged."""
        for path in (*sorted(self.folder.glob(f"{_PACK}*{_ENDING}")), *self._unpacked()):
            yield path, _read(path, columns)


def _write(path: Path, table: pa.Table) -> None:
    unfinished = path.with_name(f".{os.getpid()}.{path.name}")
    pq.write_table(table, unfinished, write_page_checksum=True)
    unfinished.replace(path)


def _joined(parts: Mapping[Path, pa.Table]) -> pa.Table:
    """Concatenate all tables; raise `InputError` if two files give a column different types."""
    joined = pa.table({ADDRESS: pa.array([], pa.string())})
    schema = joined.schema
    for path, part in parts.items():
        try:
            schema = pa.unify_schemas([schema, part.schema], promote_options="permissive")
        except pa.ArrowException as error:
            why = f"its columns do not fit those of the other results ({one_line(error)})"
            raise _damaged(path, why) from error
    return pa.concat_tables([joined, *parts.values()], promote_options="permissive")


def _read(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read the rows of a file; raise `InputError` if it is damaged, or its rows belong to other cases."""
    if not path.is_file():  # a pipe might never end
        raise _damaged(path, "is not a regular file")
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            if file.metadata.num_rows > _MOST_ROWS:
                raise _damaged(path, f"has {file.metadata.num_rows} rows; the limit is {_MOST_ROWS}")
            table = file.read(columns, use_threads=False)  # faster for small files, with less memory
    except (OSError, pa.ArrowException) as error:
        raise _damaged(path, f"not a readable result ({one_line(error)})") from error
    names = table.column_names
    if names.count(ADDRESS) != 1 or len(set(names)) < len(names):
        raise _damaged(path, f"has no column '{ADDRESS}', or a column twice")
    address = table[ADDRESS]
    if not pa.types.is_string(address.type) or address.null_count:
        raise _damaged(path, f"its column '{ADDRESS}' is not text")
    cases = address.unique().to_pylist()
    if not path.name.startswith(_PACK) and cases != [path.stem]:
        addresses = ", ".join(one_line(case[:12]) for case in cases[:3]) or "none"
        raise _damaged(path, f"holds results of cases other than those in its name ({addresses})")
    return table


def _damaged(path: Path, why: str) -> InputError:
    lost = "all its cases are" if path.name.startswith(_PACK) else "the case is"
    return InputError(f"{path}: {why}; delete it, and {lost} computed again")


def _agree(rows: Sequence[Row], others: Sequence[Row]) -> bool:
    """Return whether two results of one case are equal, apart from their times."""
    pairs = zip(rows, others, strict=False)
    return len(rows) == len(others) and all(
        row.keys() == saved.keys()
        and all(
            math.isclose(value, saved[name], rel_tol=_ROUNDING)
            or (math.isnan(value) and math.isnan(saved[name]))
            if isinstance(value, float) and isinstance(saved[name], float)
            else value == saved[name]
            for name, value in row.items()
            if name != _SECONDS
        )
        for row, saved in pairs
    )
