"""Read the tables in a ZIP archive; files with the same columns are runs."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from palpate.estimation.data.arrow import pa
from palpate.estimation.data.file_columns import FileColumns, check_size, list_first, natural_key
from palpate.estimation.data.table_layout import with_run
from palpate.estimation.data.text_dialect import TableBlock, same_columns
from palpate.robot_io.errors import InputError

_MAX_MEMBERS = 2000


def read_zip_table(
    path: Path, selected: str, read: Callable[[Path], FileColumns], endings: Sequence[str]
) -> FileColumns:
    """Read the longest table of a ZIP archive; other files with its columns are further runs.

    Each file is unpacked under a name of its own, never under its path in the archive.

    Args:
        path: path of the archive.
        selected: path in the archive of a file with the columns to read; empty for the longest table.
        read: function that reads one file.
        endings: endings of the files to read; other files are ignored.

    Raises:
        InputError: the archive is too large, is encrypted, or holds no table.
    """
    with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory() as folder:
        members = [entry for entry in archive.infolist() if _is_data(entry.filename, endings)]
        if len(members) > _MAX_MEMBERS:
            raise InputError(f"{path}: holds {len(members)} files; at most {_MAX_MEMBERS} are read")
        check_size(path, sum(entry.file_size for entry in members))
        members.sort(key=lambda entry: natural_key(Path(entry.filename)))
        tables, faults = dict[str, FileColumns](), list[str]()
        for number, entry in enumerate(members):
            name = entry.filename.lower()
            ending = PurePosixPath(name.removesuffix(".gz")).suffix + ".gz" * name.endswith(".gz")
            unpacked = Path(folder) / f"{number}{ending}"
            # `read` returns at most the stated size, and raises BadZipFile if the content differs from it.
            unpacked.write_bytes(archive.read(entry))
            try:
                tables[entry.filename] = read(unpacked)
            except InputError as error:
                faults.append(str(error).replace(str(unpacked), entry.filename))
    if not tables:
        raise InputError(faults[0] if faults else f"{path}: holds no data file; valid: {', '.join(endings)}")
    blocks = [
        TableBlock(name, tuple(table.columns.column_names), table.columns.num_rows)
        for name, table in tables.items()
    ]
    chosen, notes = same_columns(blocks, selected, path)
    used = [table for number, table in enumerate(tables.values()) if number in chosen]
    first = used[0]
    decimals = {table.decimal for table in used}
    if len(decimals) > 1:
        raise InputError(f"{path}: some files use decimal points and others commas; select one with --table")
    labels = [blocks[number].title for number in chosen]
    parts = [table.columns.select(first.columns.column_names) for table in used]
    if len(parts) > 1:
        names = [PurePosixPath(label).name for label in labels]
        names = names if len(set(names)) == len(names) else labels
        parts = [with_run(part, name) for part, name in zip(parts, names, strict=True)]
        notes.insert(0, f"{len(parts)} files of the archive, read as runs: {list_first(labels, 3)}")
    else:
        notes.insert(0, f"file '{labels[0]}' of the archive")
    notes += [f"{len(faults)} files not read, the first: {faults[0]}"] if faults else []
    columns = pa.concat_tables(parts, promote_options="permissive")
    return FileColumns(columns, first.decimal, (*notes, *first.notes))


def _is_data(name: str, endings: Sequence[str]) -> bool:
    """Return whether a file in an archive is a data file, and neither hidden nor made by macOS."""
    place = PurePosixPath(name.lower().removesuffix(".gz"))
    return place.suffix in endings and not any(part.startswith((".", "__")) for part in place.parts)
