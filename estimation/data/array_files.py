"""Read the columns of Parquet files (including LeRobot data sets), NPZ, MATLAB and HDF5 files, and arrays."""

from __future__ import annotations

import json
import math
import re
import warnings
import zipfile
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.estimation.data.column_names import TIME, guess_columns, parse_role, split_unit, words_of
from palpate.estimation.data.file_columns import OTHER_LENGTHS, FileColumns, check_size, list_first, pa, pc
from palpate.estimation.data.grouped_files import hdf5_content
from palpate.estimation.data.table_layout import with_run
from palpate.robot_io.errors import InputError

_MAX_COMPRESSION = 50  # assumed compression ratio of a MATLAB file whose variables cannot be listed
_MIN_CELL_BYTES = 4  # assumed least number of bytes per value
_MIN_COLUMNS = 3  # least number of columns of a run: time, motion and effort
_MAX_NESTED = 3  # levels of groups within a run
_JOINTS = frozenset(["joint", "motor", "servo", "axis", "leg"])  # in names of groups that are no runs
_MAX_LABEL = 60  # characters of a signal's label that are used
_BATCH_ROWS = 256


def read_parquet(path: Path) -> FileColumns:
    """Read the columns of a Parquet file; arrays of a LeRobot data set are split into elements.

    Args:
        path: path of the file.

    Raises:
        InputError: the file is too large.
    """
    from pyarrow.parquet import ParquetFile  # noqa: PLC0415, slow to import

    with path.open("rb") as opened, ParquetFile(opened) as file:  # Arrow only accepts UTF-8 file names
        check_size(path, _MIN_CELL_BYTES * file.metadata.num_rows * file.metadata.num_columns)
        batches, size = [], 0
        for batch in file.iter_batches(_BATCH_ROWS, use_threads=False):  # gives the actual size of the rows
            size += batch.nbytes
            check_size(path, size)
            batches.append(batch)
        table = pa.Table.from_batches(batches, file.schema_arrow)
    if {_TIME, _STATE} <= set(table.column_names):
        return _lerobot_columns(table, path)
    columns: dict[str, Any] = {}
    for name in table.column_names:
        matrix = _matrix(table.column(name))
        columns |= {name: table.column(name)} if matrix is None else matrix_columns(name, matrix)
    return FileColumns(pa.table(columns))


def read_npz(path: Path) -> FileColumns:
    """Read the columns of an NPZ file without unpickling objects.

    Args:
        path: path of the file.

    Raises:
        InputError: the file is too large, names an array twice, or has arrays of objects or of different
            lengths.
    """
    with zipfile.ZipFile(path) as archive:
        check_size(path, sum(entry.file_size for entry in archive.infolist()))
        names = [entry.filename.removesuffix(".npy") for entry in archive.infolist()]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{path}: the array '{twice:.60}' appears twice; rename one")
    arrays = {}
    with np.load(path, allow_pickle=False) as archive:
        for name in archive.files:
            try:
                array = archive[name]
            except ValueError as error:
                reason = (
                    "holds Python objects, which are not read because they may contain code; save the column "
                    "as numbers or text"
                )
                raise InputError(f"{path}: column '{name}' {reason}") from error
            if array.ndim > 0:  # others, such as a sampling rate or the angle of a specimen, are not columns
                arrays[name] = array
    lengths = {len(array) for array in arrays.values() if array.ndim == 1}
    for name in [name for name, array in arrays.items() if array.ndim == 2]:
        matrix = arrays.pop(name)
        if not lengths:
            arrays |= _vectors(name, matrix)
        elif len(matrix) in lengths:  # other matrices, such as a pose, are not columns
            arrays |= matrix_columns(name, matrix)
    return FileColumns(arrow_table(arrays, path))


def read_mat(path: Path) -> FileColumns:
    """Read the vectors of a MATLAB file, see `read_groups`.

    Args:
        path: path of the file.

    Raises:
        InputError: the file is too large or has no vectors.
    """
    from scipy.io import loadmat, whosmat  # noqa: PLC0415, slow to import

    try:
        size = _MAX_COMPRESSION * path.stat().st_size
        with suppress(TypeError):  # objects of MATLAB's own classes have no shape
            size = sum(8 * math.prod(shape) for _, shape, _ in whosmat(path))
        check_size(path, size)
        with warnings.catch_warnings():  # several objects of MATLAB's own classes share the name "None"
            warnings.simplefilter("ignore")
            content = loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3
        content = hdf5_content(path)
    return read_groups(content, path)


def read_groups(content: Mapping[str, Any], path: Path) -> FileColumns:
    """Return the vectors of arrays in groups; only those of the most frequent length are kept.

    A matrix is split along its longer side into columns "name 1", "name 2" and so on. Cells with rows of
    equal length are treated as a matrix. Several groups with a clock and the same columns are runs.

    Args:
        content: arrays, lists of arrays, and groups (MATLAB's structs) by name.
        path: path of the file, for error messages.

    Raises:
        InputError: there are no vectors.
    """
    named = {str(name): value for name, value in content.items() if not str(name).startswith("__")}
    if runs := _struct_runs(named):
        (first, _), *_ = runs
        note = f"{len(runs)} groups with the same columns, read as runs: {first} ..."
        parts = [with_run(arrow_table(columns, path), label) for label, columns in runs]
        return FileColumns(pa.concat_tables(parts, promote_options="permissive"), notes=(note,))
    vectors = _nested_vectors(named)
    if not vectors:
        held = list_first([f"{name} ({_kind_of(value)})" for name, value in named.items()])
        only = f", only {held}" if held else ""
        raise InputError(
            f"{path}: holds no vectors{only}; a measurement needs at least three: time, motion and effort"
        )
    lengths = [len(vector) for vector in vectors.values()]
    length = max(lengths, key=lambda each: (lengths.count(each), each))
    other_lengths = [name for name, vector in vectors.items() if len(vector) != length]
    notes = (f"{OTHER_LENGTHS}: {list_first(other_lengths)}",) if other_lengths else ()
    columns = {name: vector for name, vector in vectors.items() if len(vector) == length}
    return FileColumns(arrow_table(columns, path), notes=notes)


def _vectors(name: str, array: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return a vector, or the columns of a matrix along its longer side, by name; empty for other arrays."""
    if array.dtype.kind in "biuf" and array.ndim == 1 and len(array) > 1:
        return {name: array}
    if array.dtype.kind in "biuf" and array.ndim == 2 and array.shape[0] != array.shape[1]:
        return matrix_columns(name, array if array.shape[0] > array.shape[1] else array.T)
    return {}


def _kind_of(value: object) -> str:
    """Return what a variable of a MATLAB file is, in words for an error message."""
    if isinstance(value, Mapping):
        return "a struct"
    array = np.asarray(value)
    if array.dtype.kind == "U":
        return "text"
    if array.dtype.kind not in "biuf":
        return "an object; save its vectors as variables"
    return f"numbers of shape {array.shape}" if array.ndim else "one number"


def _struct_runs(items: Mapping[str, Any]) -> list[tuple[str, dict[str, NDArray[Any]]]]:
    """Return the groups with the same columns, which are runs, by label; empty if there are none.

    Groups without a clock are runs only if their labels differ by a number, such as "demo_0" and "demo_1",
    which is not that of a joint. If a group around them has a clock, they are parts of one measurement.
    """
    groups: dict[tuple[str, ...], list[tuple[str, dict[str, NDArray[Any]]]]] = {}
    is_timed = _has_clock(_nested_vectors(items, 0))
    pending = deque((label, value, is_timed) for label, value in items.items())
    while pending:
        label, value, is_timed = pending.popleft()
        if isinstance(value, Mapping):
            own = _nested_vectors(value, 0)
            for vectors in (own, _nested_vectors(value, _MAX_NESTED)):
                lengths = {len(vector) for vector in vectors.values()}
                has_clock = _has_clock(vectors)
                kind = "" if has_clock else re.sub(r"\d+", "", label)
                same = groups.setdefault((kind, *vectors), [])
                is_inside = any(f"{label}.".startswith(f"{outer}.") for outer, _ in same)
                is_part = is_timed or not _JOINTS.isdisjoint(words_of(kind.rpartition(".")[2]))
                is_run = len(lengths) == 1 and len(vectors) >= _MIN_COLUMNS and (has_clock or not is_part)
                if is_run and not is_inside:
                    same.append((label, vectors))
            is_timed |= _has_clock(own)
            pending += [(f"{label}.{key}", part, is_timed) for key, part in value.items()]
        elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
            parts = value if isinstance(value, list) else value.ravel().tolist()
            pending += [(f"{label} {number}", part, is_timed) for number, part in enumerate(parts, 1)]
    runs = max(groups.values(), key=lambda each: (len(each), each and len(each[0][1])), default=[])
    return runs if len(runs) > 1 else []


def _has_clock(names: Iterable[str]) -> bool:
    return any(guess.key == TIME for guess in guess_columns(list(names)))


def _nested_vectors(group: Mapping[str, Any], depth: float = math.inf) -> dict[str, NDArray[Any]]:
    """Return the vectors of a group and of the groups in it, down to a depth, by their own names.

    A name that several of the inner groups have follows that of its group: force.Data and way.Data.
    """
    vectors: dict[str, NDArray[Any]] = {}
    items: list[tuple[tuple[str, ...], Any]] = [((str(key),), part) for key, part in group.items()]
    for path, part in items:  # grows by the items of inner groups
        if isinstance(part, Mapping) and len(path) <= depth:
            inner = (_labeled_signals(part, keys) for keys in _RECORDINGS)
            items += [((*path, str(key)), value) for key, value in next(filter(None, inner), part.items())]
    inner_names = Counter(path[-1] for path, _ in items if len(path) > 1)
    names: dict[tuple[str, ...], str] = {}
    for path, part in items:
        outer, name = path[:-1], path[-1]
        if outer and (inner_names[name] > 1 or name in vectors):
            name = f"{names[outer]}.{name}"
        names[path] = name
        if isinstance(part, np.ndarray):
            cells = part.tolist() if part.ndim == 1 and part.dtype == object else []
            shapes = [*{np.shape(cell) for cell in cells}]
            array = np.array(cells) if len(shapes) == 1 and len(shapes[0]) == 1 else part
            vectors |= _vectors(name, array)
    return vectors


# Clock and signals of a recording, and label, values and unit of a signal.
_RECORDINGS = (
    ("time", "signals", "label", "values", ""),  # a "structure with time" of Simulink
    ("X", "Y", "Name", "Data", "Unit"),  # dSPACE's ControlDesk
)


def _labeled_signals(group: Mapping[str, Any], keys: tuple[str, ...]) -> list[tuple[str, Any]]:
    """Return time and signals of a recording, with labels as names; empty if the group is none."""
    clock, signals, label, values, unit = keys
    parts, time = group.get(signals), group.get(clock)
    parts = parts if isinstance(parts, list | np.ndarray) else [parts]
    parts = [part for part in parts if isinstance(part, Mapping) and values in part]
    if not parts:
        return []
    named = [("time", time.get(values) if isinstance(time, Mapping) else time)]
    for number, part in enumerate(parts, 1):
        texts = (text if isinstance(text := part.get(key), str) else "" for key in (label, unit))
        name, of_unit = (
            " ".join(text.replace('"', "").removeprefix("Model Root/").split()) for text in texts
        )
        name = name[:_MAX_LABEL] or f"signal {number}"
        named.append((f"{name} [{of_unit}]" if of_unit else name, part[values]))
    return named


def matrix_columns(name: str, matrix: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the columns of a matrix by name: "q 1", "q 2" ..., or "position_1_rad" ... of position_rad.

    Args:
        name: name of the matrix.
        matrix: array of shape (n, k).
    """
    stem, unit = split_unit(name)
    mark, ending = ("_", f"_{unit}") if parse_role(name) else (" ", f" [{unit}]")
    ending = ending if unit else ""
    return {f"{stem}{mark}{number}{ending}": column for number, column in enumerate(matrix.T, 1)}


def _matrix(column: pa.ChunkedArray) -> NDArray[Any] | None:
    """Return a column of equally long lists of numbers as a matrix, shape (n, k); None for other columns."""
    kind = column.type
    is_list = isinstance(kind, pa.ListType | pa.LargeListType | pa.FixedSizeListType)
    if not is_list or not (pa.types.is_floating(kind.value_type) or pa.types.is_integer(kind.value_type)):
        return None
    rows = column.combine_chunks()
    widths = pc.unique(pc.list_value_length(rows)).to_pylist()
    if len(widths) != 1 or widths[0] is None or not 0 < widths[0] <= _MAX_JOINTS:
        return None
    return np.asarray(rows.flatten()).reshape(-1, widths[0])


def arrow_table(arrays: Mapping[str, NDArray[Any]], place: Path) -> pa.Table:
    """Convert arrays of numbers or text to an Arrow table.

    Args:
        arrays: columns by name, shape (n,) each.
        place: source of the arrays, for error messages.

    Raises:
        InputError: the arrays have different lengths, are not one-dimensional, or contain neither real
            numbers nor text.
    """
    for name, array in arrays.items():
        if array.ndim != 1:
            raise InputError(f"{place}: column '{name}' has shape {array.shape}, expected one value per row")
        if array.dtype.kind == "c":
            raise InputError(f"{place}: column '{name}' holds complex numbers, expected real ones")
    lengths = {name: len(array) for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise InputError(f"{place}: its columns have different lengths: {listed}")
    columns = {}
    for name, array in arrays.items():
        try:
            # Arrow takes neither the other byte order nor more than 64 bits.
            is_long = array.dtype.kind == "f" and array.dtype.itemsize > _MAX_BYTES
            kind = np.dtype(np.float64) if is_long else array.dtype.newbyteorder("=")
            columns[name] = pa.array(array.astype(kind, copy=False))
        except (pa.ArrowException, TypeError, ValueError, OverflowError) as error:
            kinds = ", ".join(sorted({type(value).__name__ for value in array.tolist()})[:3])
            reason = f"holds values of type {kinds}, expected numbers or text"
            raise InputError(f"{place}: column '{name}' {reason}") from error
    return pa.table(columns)


_MAX_BYTES = 8  # of a number
_TIME, _EPISODE, _STATE = "timestamp", "episode_index", "observation.state"
_QUANTITY_BY_ARRAY = {  # quantity of each array; an action is a command and belongs to no channel
    _STATE: "position",
    "observation.position": "position",
    "observation.velocity": "velocity",
    "observation.effort": "torque",
    "observation.torque": "torque",
    "observation.current": "current",
    "action": "action",
}
_QUANTITY_BY_ENDING = {  # quantity by the ending of LeRobot's element names
    "pos": "position",
    "vel": "velocity",
    "torque": "torque",
    "effort": "torque",
    "current": "current",
}
_PALPATE_UNITS = {
    "position": "deg",
    "velocity": "deg_s",
    "torque": "Nm",
    "action": "deg",
    "force": "N",
    "time": "s",  # replaces the data set's time, which is the frame number divided by the rate
}
_MAX_JOINTS = 64
_MAX_INFO_BYTES = 1 << 20


def _lerobot_columns(table: pa.Table, path: Path) -> FileColumns:
    """Split arrays of a LeRobot episode into one column per element, with palpate's names for time and run.

    The data set states no units. The user must state those of positions and torques, except for robots of
    type `lerobot_robot_palpate`. Arrays of variable length are omitted. LeRobot 0.6 writes all numbers of an
    observation into one array: an element with a position is a joint; other elements keep their names.
    """
    info: Any = {}  # description of the data set that contains the file, if there is one
    for folder in path.absolute().parents[:4]:
        description = folder / "meta" / "info.json"
        if description.is_file() and description.stat().st_size < _MAX_INFO_BYTES:
            with suppress(OSError, ValueError, RecursionError):
                info = json.loads(description.read_text(encoding="utf-8"))
            break
    info = info if isinstance(info, Mapping) else {}
    names = _element_names(info, _STATE)
    joints = [name.removesuffix(".pos") for name in names if name.endswith(".pos")] or names
    units = _PALPATE_UNITS if info.get("robot_type") == "palpate" else {}
    columns: dict[str, Any] = {"time_s": table.column(_TIME)}
    if _EPISODE in table.column_names:
        columns["run"] = table.column(_EPISODE)
    for array in table.column_names:
        values = _matrix(table.column(array))
        if values is None:
            continue
        width = values.shape[1]
        quantity_of_array, elements = _QUANTITY_BY_ARRAY.get(array, array), _element_names(info, array)
        array_joints = [name.removesuffix(".pos") for name in elements if name.endswith(".pos")]
        column_names = [f"{quantity_of_array}_{joint + 1}" for joint in range(width)]
        if len(elements) == width and array_joints:  # such as shoulder.pos, shoulder.vel and force
            column_names = []
            for name in elements:
                joint, _, ending = name.rpartition(".")
                column, quantity = name, _QUANTITY_BY_ENDING.get(ending, "")
                if joint in array_joints and quantity:
                    quantity = quantity_of_array if quantity == "position" else quantity
                    column = f"{quantity}_{array_joints.index(joint) + 1}"
                unit = units.get(quantity or name, "")
                column_names.append(f"{column}_{unit}" if unit else column)
        columns |= dict(zip(column_names, values.T, strict=True))
    notes = ("LeRobot data set", *([f"joints {', '.join(joints)}"] if joints else []))
    return FileColumns(pa.table(columns), notes=notes)


def _element_names(info: Mapping[str, Any], array: str) -> list[str]:
    """Return the names of an array's elements from the data set's description; empty if it has none."""
    try:
        names = info["features"][array]["names"]
    except (KeyError, TypeError):
        return []
    if isinstance(names, Mapping):
        names = next(iter(names.values()), [])
    return [str(name)[:60] for name in names[:_MAX_JOINTS]] if isinstance(names, list) else []
