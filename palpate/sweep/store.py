"""Where results land: one parquet file a case, written by whoever worked it out, packed from time to time.

A file appears under its address whole or not at all, so that whatever is killed, each result is there or is
not. Parquet cannot be appended to, and ten thousand small files are slow to read: `pack` joins them. Killed
between writing the pack and removing what is in it, it leaves results twice; reading takes each once.
"""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from uuid import uuid4

import pyarrow as pa
import pyarrow.parquet as pq

from palpate.made_folders import make_folder
from palpate.sweep.case import Row
from robot_io.errors import InputError

ADDRESS = "address"
_PACK = "pack-"
_ENDING = ".parquet"


class ResultStore:
    """The results of one sweep.

    Args:
        folder: made if needed.

    Raises:
        InputError: the folder cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            make_folder(folder)
        except OSError as error:
            raise InputError(f"results folder {folder}: cannot be made ({error.strerror})") from error

    def land(self, address: str, rows: Sequence[Row]) -> None:
        """Keep the rows of one case, at least one; OSError if they cannot be written."""
        _write(
            self.folder / f"{address}{_ENDING}",
            pa.Table.from_pylist([{ADDRESS: address} | row for row in rows]),
        )

    def finished(self) -> set[str]:
        """Addresses of all results that are here."""
        found = {path.stem for path in self._landed()}
        for pack in self._packs():
            found.update(_read(pack, columns=[ADDRESS])[ADDRESS].to_pylist())
        return found

    def rows(self, addresses: Iterable[str]) -> list[Row]:
        """Rows of these cases, in their order; cases that are not here are left out, as are values of None.

        A pack has the columns of all its cases; those that a case does not have are None in it.

        Raises:
            InputError: a file is damaged.
        """
        kept: dict[str, list[Row]] = {address: [] for address in addresses}
        for path in (*self._packs(), *self._landed()):
            new: dict[str, list[Row]] = {}
            for row in _read(path).to_pylist():
                known = {name: value for name, value in row.items() if value is not None}
                new.setdefault(known.pop(ADDRESS), []).append(known)
            kept.update((address, rows) for address, rows in new.items() if address in kept)
        return [row for rows in kept.values() for row in rows]

    def pack(self) -> None:
        """Join all single files into one more pack."""
        landed = self._landed()
        if len(landed) < 2:
            return
        table = pa.concat_tables(map(_read, landed), promote_options="permissive")
        _write(self.folder / f"{_PACK}{uuid4().hex}{_ENDING}", table)
        for path in landed:
            path.unlink(missing_ok=True)

    def _landed(self) -> list[Path]:
        return sorted(
            path for path in self.folder.glob(f"*{_ENDING}") if not path.name.startswith((_PACK, "."))
        )

    def _packs(self) -> list[Path]:
        return sorted(self.folder.glob(f"{_PACK}*{_ENDING}"))


def _write(path: Path, table: pa.Table) -> None:
    unfinished = path.with_name(f".{os.getpid()}.{path.name}")
    pq.write_table(table, unfinished)
    unfinished.replace(path)


def _read(path: Path, columns: list[str] | None = None) -> pa.Table:
    try:
        return pq.read_table(path, columns=columns)
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"{path}: not a readable result ({error}); delete it to have it worked out again"
        ) from error
