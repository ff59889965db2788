"""Import several data files, each with one or more runs, as one measurement."""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.data.column_names import RUN, is_unnamed
from palpate.estimation.data.file_columns import is_bag, natural_key, pa
from palpate.estimation.data.import_file import ImportedData, import_table, with_arm
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import ENDINGS, Table, read_table
from palpate.estimation.data.table_layout import with_run
from palpate.estimation.data.text_dialect import MIN_SIGNALS
from palpate.estimation.data.text_table import is_prose
from palpate.robot_io.errors import InputError

_MAX_FILES = 2000


def data_files(folder: Path) -> list[Path]:
    """List the data files in a folder, without hidden ones, in natural order: run2 before run10.

    If the folder is a ROS 2 recording, it is the only entry. For a LeRobot data set, the list contains the
    files of its episodes.

    Args:
        folder: folder with the files.
    """
    if is_bag(folder):
        return [folder]
    paths = folder.glob("data/**/*.parquet") if is_data_set(folder) else folder.iterdir()
    named = (path for path in paths if path.name.lower().removesuffix(".gz").endswith(ENDINGS))
    return sorted((p for p in named if p.is_file() and not p.name.startswith(".")), key=natural_key)


def is_data_set(folder: Path) -> bool:
    """Return whether a folder is a LeRobot data set, whose files contain one or several episodes."""
    return (folder / "meta" / "info.json").is_file()


def import_files(
    paths: Sequence[Path],
    options: ImportOptions,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> ImportedData:
    """Read files one by one with `import_file`, and concatenate their runs.

    If the first file alone makes no channel, files with the same rows and different columns are joined side
    by side, such as one of positions and one of torques. If the files alone do not tell the same signs, they
    are read as one table, since the same sensors recorded all of them.

    Args:
        paths: paths of the files, at least one.
        options: options for reading each file.
        progress: callback that receives the current step and the completed share, from 0 to 1.

    Raises:
        InputError: a file is named twice, cannot be used, or lacks a channel of the first file, or there are
            more than 2000 files.
    """
    if len(paths) > _MAX_FILES:
        raise InputError(f"{len(paths)} data files exceed the limit of {_MAX_FILES}; join some of them")
    places = [path.resolve() for path in paths]
    if twice := [path for number, path in enumerate(paths) if places[number] in places[:number]]:
        raise InputError(f"{twice[0]}: is given twice; its runs would count as repeated measurements")
    kept = _without_prose(paths)
    prose = tuple(f"{path.name}: left out, because it has no numbers" for path in paths if path not in kept)
    paths, parts = kept, []
    for number, table in enumerate(read_tables(paths, options)):
        which = f"file {number + 1} of {len(paths)}" if len(paths) > 1 else "the file"
        progress(f"deriving the motion of {which}", (number + 0.5) / len(paths))
        parts.append(import_table(table, options))
    if joined := joined_by_signs(parts, paths, options):
        parts = [import_table(joined, options)]
    if len(parts) == 1:
        return replace(parts[0], notes=(*prose, *parts[0].notes))
    channels = []
    for first in parts[0].channels:
        same_channel = []
        for path, part in zip(paths, parts, strict=True):
            channel = next((channel for channel in part.channels if channel.name == first.name), None)
            if channel is None or channel.kind is not first.kind:
                raise InputError(f"{path}: has no channel '{first.name}', which {paths[0]} has")
            same_channel.append(channel)
        channels.append(joined_channels(same_channel))
    names = {channel.name for channel in channels}
    labels, noted = list[str](), dict[str, str]()
    for path, part in zip(paths, parts, strict=True):
        run_names = part.run_labels.values()
        labels += [path.name] if len(run_names) == 1 else [f"{path.name} {label}" for label in run_names]
        extra = [channel.name for channel in part.channels if channel.name not in names]
        ignored = (
            [f"{', '.join(extra)} left out, because {paths[0].name} has no such channel"] if extra else []
        )
        for note in (*part.notes, *ignored):
            noted.setdefault(note, path.name)  # keep the first file with this note
    notes = (*prose, *(f"{name}: {note}" for note, name in noted.items()))
    unused = tuple(name for name in parts[0].unused if all(name in part.unused for part in parts))
    ways = list(dict.fromkeys(part.read for part in parts if part.read))
    differ = " (others differ)" if len(ways) > 1 else ""
    read = f"{len(parts)} files; {ways[0]}{differ}" if ways else ""
    return ImportedData(
        with_arm(channels), dict(enumerate(labels)), notes, unused, read, {}, parts[0].columns
    )


def read_tables(paths: Sequence[Path], options: ImportOptions) -> Iterator[Table]:
    """Yield the table of each file, or one table if the first file makes no channel and all have its rows.

    Args:
        paths: paths of the files, at least one.
        options: options for reading each file.

    Raises:
        InputError: a file cannot be read.
    """
    paths = _without_prose(paths)
    first = read_table(paths[0], options.table)
    if len(paths) > 1:
        try:
            import_table(first, options)
        except InputError:
            with suppress(InputError):  # the first file's fault is the one to report
                if joined := _side_by_side(first, (read_table(more) for more in paths[1:])):
                    yield joined
                    return
    yield first
    for path in paths[1:]:
        yield read_table(path, options.table)


def _without_prose(paths: Sequence[Path]) -> Sequence[Path]:
    """Return the paths without text files that hold no table, such as a readme.txt beside data files."""
    return [path for path in paths if not (path.is_file() and is_prose(path))] or paths


def _side_by_side(first: Table, further: Iterable[Table]) -> Table | None:
    """Join tables side by side; None if they differ in their rows, or in a column that both have.

    A column without a name is named after its file, such as `tau_3` for the third column of tau.csv,
    or `tau` for its only column.
    """
    columns, files = dict[str, Any](), list[str]()
    for table in chain([first], further):
        if len(table) != len(first) or table.decimal != first.decimal:
            return None
        stem = table.path.name.split(".")[0]
        for number, name in enumerate(table.names, 1):
            own_name = stem if len(table.names) == 1 else f"{stem}_{number}"
            column, called = table.columns.column(name), own_name if is_unnamed(name) else name
            if not columns.setdefault(called, column).equals(column):
                return None
        files.append(table.path.name)
    numbered = len({re.sub(r"\d+", "", name) for name in files}) == 1
    if numbered and all(map(is_unnamed, first.names)) and len(first.names) >= MIN_SIGNALS:
        return None  # runs, such as log1.txt and log2.txt
    word = f"{len(files)} files with the same rows are joined side by side: {', '.join(files)}"
    return replace(first, path=first.path.parent, columns=pa.table(columns), notes=(word, *first.notes))


def joined_by_signs(
    parts: Sequence[ImportedData], paths: Sequence[Path], options: ImportOptions
) -> Table | None:
    """Join files of the same columns to one table whose runs are the files; None if their signs agree.

    Args:
        parts: content of each file when it is read alone.
        paths: paths of the files.
        options: options for reading each file.
    """
    has_runs = options.runs is not None or RUN in options.columns
    is_alike = all(part.roles == parts[0].roles for part in parts)
    if has_runs or not is_alike or len({part.signs for part in parts}) == 1:
        return None
    tables = [*read_tables(paths, options)]
    names = [table.path.name for table in tables]
    labels = names if len(set(names)) == len(names) else [str(table.path) for table in tables]
    columns = [with_run(table.columns, label) for table, label in zip(tables, labels, strict=True)]
    word = f"{len(tables)} files, read as one table, because alone their signs would differ"
    return replace(
        tables[0],
        path=tables[0].path.parent,
        columns=pa.concat_tables(columns, promote_options="permissive"),
        rows=np.concatenate([table.rows for table in tables]),
        notes=(word, *tables[0].notes),
    )


def joined_channels(parts: Sequence[ChannelData]) -> ChannelData:
    """Concatenate one channel of several recordings; runs are renumbered, times are unchanged.

    All parts must measure positions from the same surface. Signals that a part lacks, or has for another
    number of joints, are dropped.

    Args:
        parts: the channel in each recording, at least one, in order of time.

    Raises:
        InputError: the units of the recordings differ, such as A and N m.
    """
    first = parts[0]
    for what in ("effort_unit", "position_unit"):
        if len(units := sorted({getattr(part, what) for part in parts})) > 1:
            raise InputError(
                f"channel '{first.name}': {what.removesuffix('_unit')} is in {' and '.join(units)} in "
                "different recordings; state the conversion constant with --unit"
            )
    runs, count = [], 0
    for part in parts:
        runs.append(np.unique(part.run, return_inverse=True)[1] + count)
        count = int(runs[-1].max(initial=count - 1)) + 1
    shapes = [{name: signal.shape[1:] for name, signal in part.context.items()} for part in parts]
    names = [name for name in first.context if all(s.get(name) == shapes[0][name] for s in shapes)]
    signals = ("time_s", "position", "velocity", "acceleration", "effort", "phase")
    arrays: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in signals}
    touching = [np.zeros(len(p), dtype=np.bool_) if p.touching is None else p.touching for p in parts]
    return replace(
        first,
        **arrays,
        run=np.concatenate(runs),
        context={name: np.concatenate([part.context[name] for part in parts]) for name in names},
        recorded=frozenset(first.recorded & set(names)),
        surface=first.surface if all(part.surface for part in parts) else None,
        position_step=max(part.position_step for part in parts),
        units={
            n: unit if all(p.units[n] == unit for p in parts) else None
            for n, unit in first.units.items()
            if all(n in p.units for p in parts)
        },
        touching=None if all(part.touching is None for part in parts) else np.concatenate(touching),
        shared=None,
        import_warnings=tuple(dict.fromkeys(chain.from_iterable(part.import_warnings for part in parts))),
    )
