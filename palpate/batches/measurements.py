"""Measurements of a batch: their files, their metadata, and the case of each."""

import csv
import glob
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

from palpate.batches.tasks.measuring import measure
from palpate.common.failures import command_line_wording
from palpate.common.files import existing_file
from palpate.estimation.data.file_columns import check_size, natural_key
from palpate.estimation.data.import_files import data_files, is_data_set
from palpate.estimation.data.table import ENDINGS, read_table
from palpate.estimation.data.text_dialect import is_missing
from palpate.estimation.data.text_table import as_utf8
from palpate.robot_io.errors import InputError, PalpateError
from palpate.sweep import Case
from palpate.sweep.case import Row

FILE = "file"  # column of a list or metadata table that names a file
_FIELD = re.compile(r"\{(\w*)\}")
_MOST_BYTES = 65_536  # largest size of a header
_TEXTS = (".csv", ".tsv")


@dataclass(frozen=True, slots=True)
class BatchMeasurement:
    """Files that form one measurement."""

    name: str  # name in the table
    files: tuple[str, ...]  # sessions, data files, or folders of them; at least one; a Path takes more memory
    fields: Mapping[str, str] = field(default_factory=dict)  # such as specimen, day, arm, treatment
    where: Mapping[str, str] = field(default_factory=dict)  # rows of the file, by column


@dataclass(frozen=True)
class MeasurementCase(Case):
    """The case of a measurement; its address depends on the content of the files, not on their location."""

    files: tuple[str, ...] = ()  # absolute

    @property
    def label(self) -> str:
        """The first file; see `Case.label`."""
        return self.files[0]

    def check(self) -> None:
        """Refuse files whose content has changed since the address was computed; see `Case.check`."""
        try:
            same = self.parameters["content"] == [content_hash(Path(file)) for file in self.files]
        except OSError as error:
            raise PalpateError(f"{error.filename}: {error.strerror}") from error
        if not same:
            raise PalpateError(f"{self.files[0]}: changed while the batch was running; run the batch again")

    def run(self) -> list[Row]:
        """Read, estimate, compare and diagnose; see `Case.run`."""
        with command_line_wording():  # reasons from workers appear in the same table
            return measure([Path(file) for file in self.files], self.parameters)


def find_measurements(
    places: Sequence[Path | str],
    *,
    pattern: str | None = None,
    metadata: Path | str | None = None,
    join: str | None = None,
    split: str | None = None,
) -> list[BatchMeasurement]:
    """List the measurements of a batch in natural order of their names.

    Args:
        places: files, folders, patterns such as "data/*.csv", or one list: a CSV file with a column `file`.
        pattern: pattern of file names, with fields in braces, such as "{specimen}_{day}.csv".
        metadata: CSV file with further fields of each file, found by a column `file` or by shared fields.
        join: field; files that have the same text in it are one measurement.
        split: column of the data files; each text in it is a measurement.

    Raises:
        InputError: there is nothing to measure, or an argument does not fit the files.
    """
    listed: dict[Path, dict[str, str]] = {}
    episodes: set[Path] = set()
    for place in map(str, places):
        files = _listed(place)
        listed |= files
        episodes.update(files if is_data_set(Path(place)) else ())
    if not listed:
        raise InputError(f"{', '.join(map(str, places)) or 'no file'}: no measurement found")
    if pattern is not None:
        names = _FIELD.findall(pattern)
        if not names or len(set(names)) < len(names) or not all(name.isidentifier() for name in names):
            raise InputError(f"--pattern '{pattern}': use each field once, as in '{{specimen}}_{{day}}.csv'")
        parts = [re.escape(text) for text in _FIELD.split(pattern)]
        parts[1::2] = [f"(?P<{name}>[^/]+?)" for name in names]
        matcher = re.compile("".join(parts))
        for file in listed:
            text = "/".join(file.parts[-1 - pattern.count("/") :])
            if (match := matcher.fullmatch(text)) is None:
                raise InputError(f"--pattern '{pattern}': does not match the file name {text}")
            listed[file] |= match.groupdict()
    if metadata is not None:
        _add_fields(existing_file(Path(metadata), "metadata table"), listed)
    if join is not None and split is not None:
        raise InputError(f"--join {join} and --split {split}: give only one of them")
    if join is not None:
        return _joined(listed, join)
    # Name each file with as many of its folders as make all names different.
    paths = [str(path).split(os.sep) for path in listed]
    for depth in range(1, max(map(len, paths)) + 1):
        names = ["/".join(own[-depth:]) for own in paths]
        if len(set(names)) == len(names):
            break
    return [
        part
        for name, (file, fields) in zip(names, listed.items(), strict=True)
        for part in _parts(name, file, fields, split, by_run=file in episodes)
    ]


def case_of(measurement: BatchMeasurement, options: Mapping[str, Any]) -> MeasurementCase:
    """Make the case of a measurement; raise `OSError` if a file cannot be read.

    Args:
        measurement: files of the measurement.
        options: options for reading and evaluating it, as plain data.
    """
    content = [content_hash(Path(file)) for file in measurement.files]
    parameters = {"content": content, "where": measurement.where, "options": options}
    return MeasurementCase(TASK, parameters, files=tuple(map(os.path.abspath, measurement.files)))


TASK = "palpate.batches.tasks.measuring:measure"


def content_hash(path: Path) -> str:
    """Return the SHA-256 of a file, with its name's ending, or of a folder; raise `OSError` if unreadable.

    Args:
        path: path of the file or folder.
    """
    if path.is_dir():
        parts = sorted(file for file in path.rglob("*") if file.is_file())
        content = "".join(f"{part.name}\0{content_hash(part)}" for part in parts)
        return sha256(os.fsencode(content)).hexdigest()
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest() + "".join(path.suffixes[-2:]).lower()


def _listed(place: str) -> dict[Path, dict[str, str]]:
    """Return the measurements of a folder, of a pattern, one file, or those of a list with their fields."""
    path = Path(place)
    if path.suffix.lower() in _TEXTS and path.is_file():
        with path.open("rb") as file:  # a text file may as well be a long data file of any encoding
            names = _header(file.readline(_MOST_BYTES).decode("utf-8-sig", "replace"))[1]
        if FILE in names:
            listed, rows = dict[Path, dict[str, str]](), dict[str, int]()
            for number, line in enumerate(_lines(path), 2):
                name = path.parent / line.pop(FILE)
                if (first := rows.setdefault(os.path.abspath(name), number)) != number:
                    raise InputError(
                        f"{path}: lines {first} and {number} both name {name}; name each file once"
                    )
                listed[name] = line
            return listed
    if path.is_dir():
        files = data_files(path)
        if not files:
            raise InputError(
                f"{place}: no session or data file in it ({', '.join(ENDINGS)}); for files in subfolders, "
                f"give a pattern in quotes, such as '{place}/*/*.csv'"
            )
    elif path.exists() or not glob.has_magic(place):
        files = [existing_file(path, "session or data file")]
    else:
        files = [Path(file) for file in glob.glob(place, recursive=True)]
        if not files:
            raise InputError(f"{place}: no such file")
    return {file: {} for file in sorted(files, key=natural_key)}


def _header(line: str) -> tuple[str, list[str]]:
    """Return the separator of a header, and its names."""
    mark = max(",;\t", key=line.count)
    return mark, [name.strip() for name in next(csv.reader([line.strip()], delimiter=mark), [])]


def _lines(path: Path) -> list[dict[str, str]]:
    """Read the lines of a CSV file, by the names in its header."""
    check_size(path, path.stat().st_size)
    text = as_utf8(path.read_bytes(), path)[0].decode()
    mark, names = _header(text.partition("\n")[0])
    lines = []
    reader = csv.DictReader(text.splitlines()[1:], names, restval="", delimiter=mark)
    for number, line in enumerate(reader, 2):
        if None in line:
            raise InputError(f"{path}: line {number}: has more cells than the header")
        if not line.get(FILE, "-"):
            raise InputError(f"{path}: line {number}: its column '{FILE}' is empty")
        lines.append({name: cell.strip() for name, cell in line.items()})
    return lines


def _add_fields(path: Path, listed: Mapping[Path, dict[str, str]]) -> None:
    """Add further fields of a table; a column `file`, or fields that files already have, assign its lines."""
    lines = _lines(path)
    columns = list(lines[0]) if lines else []
    known = {name for fields in listed.values() for name in fields}
    keys = [FILE] if FILE in columns else sorted(known.intersection(columns))
    if not keys:
        raise InputError(
            f"{path}: has columns {', '.join(columns)}; one must be '{FILE}', or a field ({', '.join(known)})"
        )
    by_key: dict[tuple[str, ...], dict[str, str]] = {}
    for number, line in enumerate(lines, 2):
        key = tuple(line[name] for name in keys)
        if key in by_key:
            raise InputError(f"{path}: line {number}: {', '.join(key)} appears twice")
        by_key[key] = line
    for file, fields in listed.items():
        own = [(name,) for name in (str(file), file.name, file.stem)]
        places = own if keys == [FILE] else [tuple(fields.get(name, "") for name in keys)]
        row = next((by_key[place] for place in places if place in by_key), None)
        if row is None:
            raise InputError(f"{path}: has no row for {file}")
        fields |= {name: cell for name, cell in row.items() if name != FILE}


def _joined(listed: Mapping[Path, dict[str, str]], join: str) -> list[BatchMeasurement]:
    """Make one measurement of the files with the same text in a field, with the fields that they share."""
    groups: dict[str, list[Path]] = {}
    for file, fields in listed.items():
        if not fields.get(join):
            available = ", ".join(fields) or "none; give --pattern or --metadata"
            raise InputError(f"--join {join}: {file} has no such field. Available: {available}")
        groups.setdefault(fields[join], []).append(file)
    measurements = []
    for name, files in groups.items():
        first, *others = (listed[file] for file in files)
        shared = {key: text for key, text in first.items() if all(each.get(key) == text for each in others)}
        measurements.append(BatchMeasurement(name, tuple(map(str, files)), shared))
    return measurements


def _parts(
    name: str, file: Path, fields: Mapping[str, str], split: str | None, *, by_run: bool
) -> list[BatchMeasurement]:
    """Make one measurement of each text in a column, or of the whole file if it is unreadable."""
    whole = [BatchMeasurement(name, (str(file),), fields)]
    if split is None and not by_run:
        return whole
    column = split or "run"
    try:
        table = read_table(file)
        texts = table.labels(column)[0] if column in table.names else None
    except InputError:  # its row in the table says why
        return whole
    if texts is None and split is None:
        return whole
    if texts is None:
        raise InputError(f"--split {split}: {file} has no such column. Available: {table.listed_names}")
    return [
        BatchMeasurement(f"{name} {column}={text}", (str(file),), {**fields, column: text}, {column: text})
        for text in texts
        if not is_missing(text)
    ]
