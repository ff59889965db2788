"""Convert a public recording to the CSV file that `palpate` reads, as its recipe says.

    git clone https://github.com/OWNER/REPOSITORY                  # origin.repository of the recipe
    python benchmarks/measured/convert.py NAME --from REPOSITORY --to FOLDER

Writes FOLDER/import.csv.gz. A recipe (recipes/NAME.yaml) names origin, commit, files, columns, the expected
answer and the result of benchmarks/measured/ladder.py on which the answer is based. If --from is a git
repository, bare or not, files are read from the recipe's commit, otherwise from the folder. The recipe alone
determines whether a recording is used for development or held out, see `split_of`. JPK files and ROS bags
need the extra `bench`.
"""

import csv
import fnmatch
import gzip
import hashlib
import io
import itertools
import json
import re
import struct
import subprocess
import sys
import zipfile
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np
import pandas as pd
import python_calamine
import yaml
from nptdms import TdmsFile
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.io import loadmat

Columns = Mapping[str, NDArray[np.float64]]
Reader = Callable[[bytes, Mapping[str, Any]], list[Columns]]  # of a file's bytes and the recipe's options

RECIPES = Path(__file__).parent / "recipes"
SPLITS = ("develop", "held_out")


def split_of(recipe: Mapping[str, Any]) -> str:
    """Return the split of a recording.

    It is the recipe's `split` if there is one: the recordings that were collected last are all held out.
    Otherwise it is `develop` if the last hex digit of the name's SHA-256 is even.
    """
    by_name = SPLITS[int(hashlib.sha256(recipe["name"].encode()).hexdigest()[-1], 16) % 2]
    return str(recipe.get("split", by_name))


def load_recipe(name: str) -> dict[str, Any]:
    """Read a recipe by name.

    Raises:
        FileNotFoundError: there is no such recipe.
    """
    recipe: dict[str, Any] = yaml.load((RECIPES / f"{name}.yaml").read_text("utf-8"), yaml.CSafeLoader)
    return recipe


class Origin:
    """Files of a repository at one commit, or of a plain folder."""

    def __init__(self, folder: Path, commit: str) -> None:
        bare = (folder / "HEAD").is_file()
        self._folder = folder
        self._git = folder if bare else folder / ".git" if (folder / ".git").exists() else None
        self._commit = commit

    def _run(self, *arguments: str) -> bytes:
        command = ["git", "--git-dir", str(self._git), *arguments]
        return subprocess.run(command, check=True, capture_output=True).stdout

    def names(self) -> list[str]:
        """Return the paths of all files, relative to the repository."""
        if self._git is None:
            files = filter(Path.is_file, self._folder.rglob("*"))
            return [path.relative_to(self._folder).as_posix() for path in files]
        listing = self._run("ls-tree", "-r", "-z", "--name-only", self._commit)
        return listing.decode("utf-8", "surrogateescape").rstrip("\0").split("\0")

    def read(self, path: str) -> bytes:
        """Return the content of one file, unpacked if it is compressed by gzip."""
        file, in_git = self._folder / path, f"{self._commit}:{path}"
        content = file.read_bytes() if self._git is None else self._run("show", in_git)
        return gzip.decompress(content) if path.endswith(".gz") else content


def _number(cell: str, decimal: str) -> float:
    try:
        return float(cell.strip().strip('"').replace(decimal, "."))
    except ValueError:
        return np.nan


def _named(rows: NDArray[np.float64], names: list[str]) -> Columns:
    """Return columns by number and by name."""
    columns = {str(i): column for i, column in enumerate(rows.T)}
    named = zip(names, rows.T, strict=False)
    return columns | {name.strip().strip('"'): column for name, column in named if name.strip()}


def read_text(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read a text table.

    Options: `delimiter` (default: blanks), `skip` lines before the numbers (the last of them holds the
    names), `decimal` mark, `encoding`, `key`: number of the column that must hold a number, `width`: number
    of lines of a row, `transpose`: each line holds a column, `blanks`: characters that count as blanks, such
    as the brackets of arrays.

    Returns:
        One table. Rows with fewer cells than the first, or with no number in the key column, are left out.
    """
    text = content.decode(options.get("encoding", "utf-8-sig"), "replace")
    lines = text.translate(dict.fromkeys(map(ord, options.get("blanks", "")), " ")).splitlines()
    skip, delimiter = options.get("skip", 0), options.get("delimiter")
    names = lines[skip - 1].split(delimiter) if skip else []
    cells = [line.split(delimiter) for line in lines[skip:] if line.strip()]
    if width := options.get("width"):
        cells = [list(itertools.chain(*cells[i : i + width])) for i in range(0, len(cells), width)]
    if options.get("transpose"):
        cells = [list(row) for row in zip(*cells, strict=True)]
    width = len(cells[0])
    decimal = options.get("decimal", ".")
    rows = [[_number(cell, decimal) for cell in row[:width]] for row in cells if len(row) >= width]
    table = np.array(rows)
    return [_named(table[np.isfinite(table[:, options.get("key", 0)])], names)]


def read_workbook(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read sheets of an Excel file; `skip` as in `read_text`.

    Options: `sheets`: pattern of sheet names, or a list of them (default: the first sheet).
    """
    book = python_calamine.CalamineWorkbook.from_filelike(io.BytesIO(content))
    wanted = options.get("sheets", book.sheet_names[:1])
    chosen = wanted if isinstance(wanted, list) else fnmatch.filter(book.sheet_names, wanted)
    skip = options.get("skip", 1)
    tables: list[Columns] = []
    for sheet in chosen:
        rows = book.get_sheet_by_name(sheet).to_python(skip_empty_area=False)
        names = [str(name) for name in rows[options.get("names", skip - 1)]]
        numbers = [[cell if isinstance(cell, int | float) else np.nan for cell in row] for row in rows[skip:]]
        tables.append(_named(np.array(numbers, dtype=np.float64), names))
    return tables


def read_matlab(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read vectors and columns of matrices of a MATLAB file (up to version 7.2): `x`, `x.0`, `x.1` ...

    Field `x` of a structure `s` is named `s.x`; in an array of structures or a cell, `s.0.x`, `s.1.x` ...
    An array of three dimensions holds repeated readings; the mean over its last dimension is taken. Contents
    of objects, such as time series, are numbered over all objects of the file: `objects.19`,
    `objects.19.0` ...
    """
    del options
    arrays = loadmat(io.BytesIO(content))
    arrays.pop("None", None)  # a placeholder of the objects
    hidden = arrays.pop("__function_workspace__", None)
    return [_columns_of(arrays if hidden is None else arrays | {"objects": _objects(hidden.tobytes())})]


def _objects(workspace: bytes) -> NDArray[np.object_]:
    """Return the contents of all objects of a MATLAB file in one cell.

    The workspace, a hidden variable of the file, is itself a file: a short header (version, byte order, four
    more bytes), then variables without names. The first of these holds the objects.
    """
    header = workspace[:4].rjust(128, b" ")
    order = "<" if workspace[2:4] == b"IM" else ">"
    (size,) = struct.unpack(f"{order}I", workspace[12:16])
    first = loadmat(io.BytesIO(header + workspace[8 : 16 + size]))["__function_workspace__"]
    held = first["MCOS"].item()
    cell: NDArray[np.object_] = held["arr"].item() if held.dtype.names else held
    return cell


def read_numpy(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read vectors and columns of matrices of a NumPy archive: `x`, `x.0`, `x.1` ..."""
    del options
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return [_columns_of({name: np.atleast_2d(archive[name]) for name in archive.files})]


def _columns_of(arrays: Mapping[str, Any]) -> Columns:
    """Return the columns of all numeric matrices, transposed if wide; those of structures by field."""
    columns: dict[str, NDArray[np.float64]] = {}
    for name, content in arrays.items():
        is_cell = isinstance(content, np.ndarray) and content.dtype == object and content.size == 1
        value = np.asarray(content.item() if is_cell else content)
        if value.dtype.names and value.size == 1:
            columns |= _columns_of({f"{name}.{key}": value[key].item() for key in value.dtype.names})
        elif value.dtype.names:
            for i, item in enumerate(value.ravel()):
                columns |= _columns_of({f"{name}.{i}.{key}": item[key] for key in value.dtype.names})
        elif value.dtype == object and value.ndim:  # otherwise it is None, an empty structure
            for i, item in enumerate(value.ravel()):
                columns |= _columns_of({f"{name}.{i}": item})
        elif value.dtype.kind in "fiu" and value.ndim in (2, 3) and value.size > 1:
            matrix = value.mean(axis=2) if value.ndim == 3 else value
            upright = np.asarray(matrix if matrix.shape[0] >= matrix.shape[1] else matrix.T, dtype=np.float64)
            columns |= {name: upright[:, 0]} | {f"{name}.{i}": column for i, column in enumerate(upright.T)}
    return columns


def read_jpk(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read the curves of a JPK force file or map: `time`, `height`, `deflection`, `force`, `segment`.

    Options: `height`: name of the channel with the height (default `height`).
    """
    from afmformats.formats.fmt_jpk import jpk_data, jpk_reader  # noqa: PLC0415

    reader = jpk_reader.JPKReader(io.BytesIO(content))
    height = (options.get("height", "height"), "default")
    wanted = (height, ("vDeflection", "distance"), ("vDeflection", "force"))
    curves: list[Columns] = []
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for curve in range(len(reader)):
            parts: list[NDArray[np.float64]] = []
            start = 0.0
            for segment in reader.get_index_segment_numbers(curve):
                # `get_data` of this reader fails for curves of more than four segments.
                about = reader._get_index_segment_properties(curve, segment)
                folder = reader.get_index_segment_path(curve, segment)
                channels = [
                    jpk_data.load_dat_unit(archive.open(f"{folder}channels/{name}.dat"), name, about, slot)[0]
                    for name, slot in wanted
                ]
                duration = about["force-segment-header.duration"]
                time = start + np.linspace(0.0, duration, len(channels[0]), endpoint=False)
                parts.append(np.stack([time, *channels, np.full(len(time), float(segment))]))
                start += duration
            names = ("time", "height", "deflection", "force", "segment")
            curves.append(dict(zip(names, np.concatenate(parts, axis=1), strict=True)))
    return curves


def read_trials(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read a table with trials side by side; `names` are the columns of each (default `x` and `y`).

    Options: `packed`: format of the table (default `text`), and the options of this format.
    """
    (table,) = READERS[options.get("packed", "text")](content, options)
    names = options.get("names", ["x", "y"])
    count = sum(name.isdigit() for name in table)
    trials: list[Columns] = []
    for first in range(0, count - len(names) + 1, len(names)):
        kept = np.isfinite(table[str(first)])
        trials.append({name: table[str(first + i)][kept] for i, name in enumerate(names)})
    return trials


def read_zip(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read the tables in an archive, sorted by name.

    Options: `members`: pattern of the names of the tables; `packed`: their format (default `text`), and the
    options of this format.
    """
    reader = READERS[options.get("packed", "text")]
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        names = sorted(fnmatch.filter(archive.namelist(), options["members"]))
        return [table for name in names for table in reader(archive.read(name), options)]


def read_json(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read numbers from JSON: a list of records, series of graphs, lists of rows, or named lists.

    Options: `records`: key of the list of records, whose keys are the names; or `graphs`: key of a list
    of phases, and key of the series of a phase; the series of all phases are joined; or `tables`: keys of
    the lists of rows, one table each, and `names` of their columns. Without these options, each list of
    numbers is a column. `under`: key of the part of the file that holds all this.
    """
    table = json.loads(content)
    if "under" in options:
        table = table[options["under"]]
    if "tables" in options:
        names = options.get("names", [])
        return [_named(np.array(table[key], dtype=np.float64), names) for key in options["tables"]]
    if "graphs" in options:
        phases, graph = options["graphs"]
        graphs = [phase[graph] for phase in table[phases]]
        names = [name for name in graphs[0] if all(isinstance(part[name], list) for part in graphs)]
        return [{name: np.concatenate([part[name] for part in graphs], dtype=np.float64) for name in names}]
    if "records" not in options:
        lists = {name: values for name, values in table.items() if isinstance(values, list)}
        return [{name: np.array(values, dtype=np.float64) for name, values in lists.items()}]
    rows = table[options["records"]]
    names = [name for name, value in rows[0].items() if isinstance(value, int | float)]
    return [{name: np.array([row[name] for row in rows], dtype=np.float64) for name in names}]


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:  # noqa: ANN401
    """Yield names and values of the numbers in a ROS message, times in s; texts are skipped."""
    if hasattr(value, "nanosec"):
        yield name, value.sec + 1e-9 * value.nanosec
    elif isinstance(value, int | float | np.generic):
        yield name, float(value)
    elif not isinstance(value, str):
        for key, inner in vars(value).items() if hasattr(value, "__msgtype__") else enumerate(value):
            yield from _numbers(inner, f"{name}.{key}" if name else str(key))


def read_bag(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read the numbers of one topic of a ROS 1 bag by name, such as `wrench.force.x` or `position.0`.

    Options: `topic`.

    Raises:
        FileNotFoundError: the bag has no message of this topic; the text lists its topics.
    """
    from rosbags.highlevel import AnyReader  # noqa: PLC0415

    topic = options["topic"]
    with NamedTemporaryFile(suffix=".bag") as file:
        file.write(content)
        file.flush()
        with AnyReader([Path(file.name)]) as bag:
            read = [bag.deserialize(data, of.msgtype) for of, _, data in bag.messages() if of.topic == topic]
            topics = ", ".join(sorted(bag.topics))
    if not read:
        raise FileNotFoundError(f"topic {topic}: no message of it; the bag's topics: {topics}")
    rows = [dict(_numbers(message, "")) for message in read]
    names = [name for name in rows[0] if all(name in row for row in rows)]  # arrays may differ in length
    return [{name: np.array([row[name] for row in rows]) for name in names}]


def read_binary(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read consecutive numbers of one type: `0`, `1` ...

    Options: `type`: NumPy's name of their type (`>i2`); `skip`: bytes before them; `count`: how many numbers
    there are (default: all up to the end); `per_row`: numbers in a row (default 1).
    """
    kind = np.dtype(options["type"])
    numbers = np.frombuffer(content, kind, options.get("count", -1), options.get("skip", 0))
    return [_named(numbers.astype(np.float64).reshape(-1, options.get("per_row", 1)), [])]


def read_tdms(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read the channels of a TDMS file of LabVIEW as they are stored: a table for each group, sorted by name.

    Options: `groups`: pattern of the names of the groups (default: all).
    """
    groups = {group.name.strip(): group for group in TdmsFile.read(io.BytesIO(content)).groups()}
    return [
        {each.name: np.asarray(each.raw_data, np.float64) for each in groups[name].channels() if len(each)}
        for name in sorted(fnmatch.filter(groups, options.get("groups", "*")))
    ]


def read_quoted(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read a CSV file with quoted cells that hold a number or a list of numbers: `name.0`, `name.1` ...

    Its first row holds the names. Cells of another form become NaN.
    """
    del options
    columns: dict[str, NDArray[np.float64]] = {}
    for name, cells in pd.read_csv(io.BytesIO(content)).items():
        if pd.api.types.is_numeric_dtype(cells):
            columns[str(name)] = cells.to_numpy(np.float64)
        else:
            for i, part in cells.str.strip("[] \n").str.split(r"[,\s]+", expand=True, regex=True).items():
                columns[f"{name}.{i}"] = pd.to_numeric(part, errors="coerce").to_numpy(np.float64)
    return [columns]


def read_nid(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read a curve of a NID file (AFM by Nanosurf): `FRAME.CHANNEL`, such as `Spec forward.Deflection`.

    The file has sections of text, `#!`, then the signed integers of all channels. Options: `frames`: the
    frames to read.
    """
    text, _, data = content.partition(b"#!")
    columns: dict[str, NDArray[np.float64]] = {}
    at = 0
    for section in re.findall(r"^\[DataSet-\d+:\d+\][^[]*", text.decode("latin-1"), re.MULTILINE):
        about = dict(line.split("=", 1) for line in section.splitlines() if "=" in line)
        count, bits = int(about["Points"]) * int(about["Lines"]), int(about["SaveBits"])
        raw = np.frombuffer(data, f"<i{bits // 8}", count, at).astype(np.float64)
        at += count * bits // 8
        if about["Frame"] in options["frames"]:
            values = (raw / 2.0**bits + 0.5) * float(about["Dim2Range"]) + float(about["Dim2Min"])
            columns[f"{about['Frame']}.{about['Dim2Name']}"] = values
    return [columns]


def read_ibw(content: bytes, options: Mapping[str, Any]) -> list[Columns]:
    """Read a wave of Igor (version 5, numbers of one dimension): its values `0` and their `time`."""
    del options
    kind = {2: "<f4", 4: "<f8"}[struct.unpack_from("<h", content, 80)[0]]
    values = np.frombuffer(content, kind, struct.unpack_from("<I", content, 76)[0], 384)
    (step,) = struct.unpack_from("<d", content, 148)
    return [{"0": values.astype(np.float64), "time": np.arange(len(values)) * step}]


READERS: dict[str, Reader] = {
    reader.__name__.removeprefix("read_"): reader
    for reader in (
        *(read_bag, read_binary, read_ibw, read_jpk, read_json, read_matlab, read_nid, read_numpy),
        *(read_quoted, read_tdms, read_text, read_trials, read_workbook, read_zip),
    )
}


def _column(tables: Columns, spec: Mapping[str, Any], item: str, count: int) -> NDArray[np.float64]:
    """Return an output column of `count` rows: factors times columns, or row numbers times `step`.

    `zero` is the number of first samples whose mean is subtracted, or `mean` to subtract the mean of all.
    `item` replaces {} in the names of columns. `unwrap` is the period of an encoder that wraps. `sines` adds
    the links of a chain: the length of each times the sine of a phase plus factors times columns.
    `signed_by` names the column that gives the sign if only the magnitude was measured. Values of at least
    `sign_bit` (in the output's unit) are negative: some servos report the magnitude with this bit set.
    """
    values: NDArray[np.float64] = np.arange(count, dtype=np.float64) * float(spec.get("step", 0.0))
    for name, factor in spec.get("sum", {}).items():
        values = values + float(factor) * tables[str(name).replace("{}", item)]
    values = values + float(spec.get("offset", 0.0))
    for length, phase, angles in spec.get("sines", []):
        angle = sum(float(factor) * tables[str(name)] for name, factor in angles.items())
        values = values + float(length) * np.sin(float(phase) + angle)
    if "sign_bit" in spec:
        values = np.where(values < spec["sign_bit"], values, spec["sign_bit"] - values)
    if "unwrap" in spec:
        values = np.unwrap(values, period=float(spec["unwrap"]))
    if "signed_by" in spec:
        values = values * np.sign(tables[str(spec["signed_by"])])
    zero = spec.get("zero")
    if zero is None:
        return values
    first = values if zero == "mean" else values[: int(zero)]  # otherwise the number of first samples
    return values - float(np.nanmean(first))


def _files(recipe: Mapping[str, Any], origin: Origin) -> list[str]:
    """Return the paths of the recipe's files in its order; a pattern gives all matches, sorted by name."""
    names = origin.names()
    paths: list[str] = []
    for pattern in recipe["read"]["files"]:
        matches = [pattern] if pattern in names else sorted(fnmatch.filter(names, pattern))
        if not matches:
            raise FileNotFoundError(f"{pattern}: no such file in the origin")
        paths += matches
    return paths


def _tables(recipe: Mapping[str, Any], origin: Origin) -> Iterator[list[Columns]]:
    """Yield the tables of each file, after `join`, `chain`, `order` and `restarts`.

    `join`: names of files that are joined into one table, with columns NAME.COLUMN (NAME is the first
    column). `apart`: other options for some of these files. `clocks`: time column of each of these files, and
    what to add to it [s]; all numbers are interpolated at the times of the first. `backwards`: those of these
    files whose rows are read in reverse order. `chain`: columns that concatenate others. `order`: the column
    by which the rows are sorted. `restarts`: the column that falls where a new run begins.
    """
    read, paths = recipe["read"], _files(recipe, origin)
    joined, apart = read.get("join", []), read.get("apart", {})
    for first in range(0, len(paths), max(len(joined), 1)):
        if joined:
            parts = {}
            for name, path in zip(joined, paths[first : first + len(joined)], strict=True):
                options = {**read, **apart.get(name, {})}
                parts[name] = READERS[options["format"]](origin.read(path), options)[0]
            if clocks := read.get("clocks"):
                parts = _on_one_clock(parts, clocks)
            for name in read.get("backwards", []):
                parts[name] = _rows(parts[name], slice(None, None, -1))
            columns = {
                f"{name}.{key}": values for name, part in parts.items() for key, values in part.items()
            }
            tables = [columns | {name: part["0"] for name, part in parts.items() if "0" in part}]
        else:
            tables = READERS[read["format"]](origin.read(paths[first]), read)
        if chain := read.get("chain"):
            tables = [
                {name: np.concatenate([table[key] for key in keys]) for name, keys in chain.items()}
                for table in tables
            ]
        if key := read.get("order"):
            tables = [_rows(table, np.argsort(table[key])) for table in tables]
        if clock := read.get("restarts"):
            tables = [run for table in tables for run in _split(table, str(clock))]
        yield tables


def _rows(table: Columns, rows: Any) -> dict[str, NDArray[np.float64]]:  # noqa: ANN401
    """Return the rows of a table that a NumPy index selects."""
    return {name: values[rows] for name, values in table.items()}


def _on_one_clock(parts: Mapping[str, Columns], clocks: Mapping[str, Any]) -> dict[str, Columns]:
    """Interpolate tables at the times of the first one; NaN outside the times of a table."""
    times = {name: parts[name][str(clock)] + float(shift) for name, (clock, shift) in clocks.items()}
    first = next(iter(times.values()))

    def at_first(name: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
        order = np.unique(times[name], return_index=True)[1]
        return np.interp(first, times[name][order], values[order], left=np.nan, right=np.nan)

    return {
        name: {column: at_first(name, values) for column, values in table.items()}
        for name, table in parts.items()
    }


def _split(table: Columns, clock: str) -> list[Columns]:
    """Split a table where its clock falls back; rows without a time are omitted."""
    table = _rows(table, np.isfinite(table[clock]))
    edges = [0, *(np.flatnonzero(np.diff(table[clock]) < 0) + 1).tolist(), len(table[clock])]
    return [_rows(table, slice(*ends)) for ends in itertools.pairwise(edges)]


def runs_of(recipe: Mapping[str, Any], origin: Origin) -> Iterator[Columns]:
    """Yield all runs of a recording.

    `each` lists texts that replace {} in the recipe's columns, one run each.

    Args:
        recipe: content of the recipe.
        origin: the repository that it names.

    Yields:
        Output columns of each run, decimated by block means of `every` rows. Runs with fewer rows than
        `shortest` are omitted.
    """
    read = recipe["read"]
    for number, tables in enumerate(_tables(recipe, origin)):
        for table, item in itertools.product(tables, read.get("each", [""])):
            cut = _rows(table, slice(*read.get("rows", [None])))
            columns = _kept(_output(recipe["columns"], cut, str(item), number), read)
            if len(columns["time_s"]) < read.get("shortest", 0):
                continue
            if "thin" in read:
                columns = _thin(columns, read["thin"])
            if "surface" in read:
                _find_surface(columns, read["surface"])
            pieces, count, every = read.get("pieces", 1), len(columns["time_s"]), read.get("every", 1)
            edges = [piece * count // pieces for piece in range(pieces + 1)]
            for start, stop in itertools.pairwise(edges):
                blocks = slice(start, stop - (stop - start) % every)
                yield {name: each[blocks].reshape(-1, every).mean(axis=1) for name, each in columns.items()}


def _output(specs: Mapping[str, Any], table: Columns, item: str, file: int) -> dict[str, NDArray[np.float64]]:
    """Return the output columns of a table, made by `_column`, or constant with one number for each file."""
    named = [str(name).replace("{}", item) for spec in specs.values() for name in spec.get("sum", {})]
    count = len(table[named[0]] if named else next(iter(table.values())))  # others may have other lengths
    columns = {
        name: np.full(count, float(spec["of_file"][file]))
        if "of_file" in spec
        else _column(table, spec, item, count)
        for name, spec in specs.items()
    }
    for name in (name for name, spec in specs.items() if spec.get("integral")):
        columns[name] = cumulative_trapezoid(columns[name], columns["time_s"], initial=0.0)
    return columns


def _kept(columns: Columns, read: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Return complete rows with increasing time and with values in the ranges of `within`."""
    time = columns["time_s"]  # it repeats where a row was written twice
    kept = np.all([np.isfinite(values) for values in columns.values()], axis=0)
    kept &= np.concatenate([[True], time[1:] > np.maximum.accumulate(time)[:-1]])
    for name, (low, high) in read.get("within", {}).items():
        kept &= (columns[name] >= low) & (columns[name] <= high)
    return _rows(columns, kept)


def _thin(columns: Columns, step: float) -> dict[str, NDArray[np.float64]]:
    """Return rows that are at least `step` [s] later than the previous one that is kept."""
    kept: list[int] = []
    for i, time in enumerate(columns["time_s"]):
        if not kept or time - columns["time_s"][kept[-1]] >= step:
            kept.append(i)
    return _rows(columns, kept)


def _find_surface(columns: dict[str, NDArray[np.float64]], sigmas: float) -> None:
    """Set the zero of the displacement to the surface, where the force finally exceeds its noise.

    Args:
        columns: columns of one run. The mean force in the first tenth of the approach is subtracted.
        sigmas: threshold of the force, in standard deviations of that part.
    """
    x, force = columns["displacement_m"], columns["force_N"]
    peak = int(np.argmax(force))
    free = force[: max(peak // 10, 3)]
    force = columns["force_N"] = force - free.mean()
    below = np.flatnonzero(force[:peak] < sigmas * free.std())
    columns["displacement_m"] = x - x[below[-1] if len(below) else 0]


def convert(recipe: Mapping[str, Any], origin: Origin, folder: Path) -> int:
    """Write FOLDER/import.csv.gz; with `raw` in the recipe, also the origin's files into FOLDER/raw.

    A recipe without columns keeps only the origin's files.

    Args:
        recipe: content of the recipe.
        origin: the repository that it names.
        folder: created if it does not exist.

    Returns:
        Number of rows.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if "raw" in recipe:
        (folder / "raw").mkdir(exist_ok=True)
        for number, path in enumerate(_files(recipe, origin)):
            (folder / "raw" / f"{number} {PurePosixPath(path).name}").write_bytes(origin.read(path))
    if "columns" not in recipe:
        return 0
    names, total = list(recipe["columns"]), 0
    with (
        gzip.GzipFile(folder / "import.csv.gz", "wb", mtime=0) as packed,
        io.TextIOWrapper(packed, "utf-8", newline="") as file,
    ):
        writer = csv.writer(file)
        writer.writerow([*names, "run"])
        for run, columns in enumerate(runs_of(recipe, origin)):
            rows = zip(*(columns[name] for name in names), strict=True)
            writer.writerows([*(f"{value:.9g}" for value in row), run] for row in rows)
            total += len(columns[names[0]])
    return total


def main() -> None:
    """Convert the recording named on the command line."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    names = ", ".join(sorted(path.stem for path in RECIPES.glob("*.yaml")))
    parser.add_argument("name", help=names)
    parser.add_argument("--from", dest="origin", type=Path, required=True, help="repository of the origin")
    parser.add_argument("--to", type=Path, required=True, help="folder of import.csv.gz")
    options = parser.parse_args()
    try:
        recipe = load_recipe(options.name)
        rows = convert(recipe, Origin(options.origin, recipe["origin"]["commit"]), options.to)
    except FileNotFoundError as error:
        sys.exit(f"{options.name}: {error}")
    except ModuleNotFoundError as error:
        sys.exit(f"{options.name}: {error.name} is not installed: pip install '.[bench]'")
    print(f"{options.to / 'import.csv.gz'}: {rows} rows ({split_of(recipe)})")


if __name__ == "__main__":
    main()
