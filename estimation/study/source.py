"""Read the measurement of a study: a session, a data file, or arrays in memory."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.control.loop.task import Phase
from palpate.estimation.base_model import NO_ARM, Arm
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.array_files import arrow_table
from palpate.estimation.data.column_names import RUN
from palpate.estimation.data.contact import tared
from palpate.estimation.data.file_columns import FileColumns, is_session, pa
from palpate.estimation.data.import_file import ImportedData, import_file, import_table
from palpate.estimation.data.import_files import data_files, import_files, joined_channels
from palpate.estimation.data.import_options import NO_OPTIONS, ImportOptions
from palpate.estimation.data.table import table_of
from palpate.estimation.fit.long_data import shortened
from palpate.robot_io.errors import InputError
from palpate.robot_io.extras import missing_package

if TYPE_CHECKING:
    from palpate.robot_io.session import Session

IN_MEMORY = "data"  # name of measurements without a file
_CHANNEL_NAME = re.compile(r"\w{1,64}", re.ASCII)


@dataclass(frozen=True)
class DataSource:
    """Measurement of a study: its channels, arm and origin."""

    name: str  # name of the file for display
    channels: tuple[ChannelData, ...]  # the measured channels
    arm: Arm = NO_ARM  # the arm to which the channels belong
    path: Path | None = None  # session, folder of sessions, or data file; None for measurements in memory
    session: Session | None = None  # the first session; None if the source is not a session
    unused: tuple[str, ...] = ()  # unused numeric columns
    notes: tuple[str, ...] = ()  # notes on the data for the user
    more: tuple[Session, ...] = ()  # further probing sessions of the same arm
    read: str = ""  # assignment of columns in a data file; empty for a session
    # Description of the averaging of each channel that was too long, by name.
    averaged: Mapping[str, str] = field(default_factory=dict)
    # For channels whose runs were cut into stretches, the recorded run of each stretch by its number.
    stretches: Mapping[str, Mapping[int, int]] = field(default_factory=dict)

    @property
    def probed(self) -> bool:
        """Whether the source is a probing session."""
        from palpate.control.loop.tick_record import STREAM_NAME  # noqa: PLC0415, needs the MCAP library

        return self.session is not None and STREAM_NAME in self.session.stream_names

    @property
    def runs(self) -> tuple[int, ...]:
        """Recorded run numbers of all channels, ascending."""
        return tuple(sorted({run for channel in self.channels for run in self.recorded(channel)}))

    def recorded(self, channel: ChannelData) -> list[int]:
        """Return, for each run of a channel, the recorded run of which it is the whole or a stretch.

        Args:
            channel: channel of this source.
        """
        run_of = self.stretches.get(channel.name, {})
        return [run_of.get(run, run) for run in channel.runs.tolist()]

    def runs_of(self, channel: ChannelData, recorded: Sequence[int]) -> tuple[int, ...]:
        """Return the numbers of a channel's runs, or stretches, that belong to recorded runs.

        Args:
            channel: channel of this source.
            recorded: numbers of runs as recorded; see `recorded`.
        """
        return tuple(channel.runs[np.isin(self.recorded(channel), recorded)].tolist())

    def without(self, runs: Sequence[int]) -> DataSource:
        """Return the source without some runs.

        Args:
            runs: numbers of recorded runs to remove.
        """
        remaining = (c.of_runs(np.setdiff1d(c.runs, self.runs_of(c, runs))) for c in self.channels)
        return replace(self, channels=tuple(remaining))

    def tared(self, names: Collection[str]) -> tuple[ChannelData, ...]:
        """Return channels with the force in free air subtracted, as the estimation of a stiffness requires.

        Args:
            names: names of the channels.
        """
        if self.session is None:
            return tuple(tared(channel) for channel in self.channels if channel.name in names)
        from palpate.estimation.data.channels import session_channels  # noqa: PLC0415, needs the MCAP library
        from palpate.estimation.study.sessions import with_ticks  # noqa: PLC0415, the same

        joints = any(name.startswith("joint_") for name in names)
        every = session_channels(*map(with_ticks, (self.session, *self.more)), tared=True, joints=joints)
        chosen = (channel.of_runs(np.array(self.runs)) for channel in every if channel.name in names)
        return tuple(tared(channel) for channel in chosen if len(channel))


def open_source(data: Any, options: ImportOptions = NO_OPTIONS, arm: Arm | None = None) -> DataSource:  # noqa: ANN401
    """Read a measurement from any supported source.

    Args:
        data: path of a session, of a folder of sessions of one arm, of a data file, or of a folder of data
            files; or a list of data files; or a table (pandas, pyarrow, or a dict of arrays (n,)) with column
            names as in a file; or one or several channels.
        options: options for reading a file or table; not allowed for sessions and channels.
        arm: the arm to which the channels belong; None to use the arm of the data.

    Raises:
        InputError: the data cannot be used.
    """
    source = _source_of(data, replace(options, joint_names=arm.joint_names) if arm else options)
    return source if arm is None else replace(source, arm=arm, notes=(*source.notes, *arm.notes))


def without_unreadable_joints(source: DataSource) -> DataSource:
    """Drop the joints of an arm that also pressed an object if Pinocchio is not installed, and add a note.

    Args:
        source: the measurement.
    """
    contacts = tuple(channel for channel in source.channels if channel.kind is ChannelKind.CONTACT)
    if not (contacts and source.arm.urdf) or len(contacts) == len(source.channels) or find_spec("pinocchio"):
        return source
    note = f"the joints are left out: {missing_package('pinocchio')}"
    return replace(source, channels=contacts, notes=(*source.notes, note))


def limit_length(source: DataSource, held_out: Sequence[int] = ()) -> DataSource:
    """Shorten recordings that are too long, see `shortened`, and add a note on each.

    The ticks of a long session are dropped from memory, and read again when they are needed.

    Args:
        source: the measurement.
        held_out: runs excluded from fitting.

    Raises:
        InputError: there is no such run.
    """
    if not (isinstance(held_out, Iterable) and all(isinstance(run, Integral) for run in held_out)):
        raise InputError(f"held_out={held_out!r}: give a list of run numbers, such as [2, 5]")
    if unknown := sorted(set(held_out).difference(source.runs)):
        named = ", ".join(map(str, source.runs))
        raise InputError(f"runs to hold out: there is no run {unknown[0]}. Available: {named}")
    short = [shortened(channel, source.runs_of(channel, held_out)) for channel in source.channels]
    notes = {channel.name: words for channel, words, _ in short if words}
    if notes and source.session is not None:
        from palpate.estimation.study.sessions import without_ticks  # noqa: PLC0415, needs the MCAP library

        first, *more = map(without_ticks, (source.session, *source.more))
        source = replace(source, session=first, more=tuple(more))
    return replace(
        source,
        channels=tuple(channel for channel, _, _ in short),
        averaged={**source.averaged, **notes},
        notes=(*source.notes, *notes.values()),
        stretches={**source.stretches, **{channel.name: cut for channel, _, cut in short if cut}},
    )


def joined(first: DataSource, second: DataSource) -> DataSource:
    """Join two measurements in memory; the runs of the second follow those of the first.

    Args:
        first: the first measurement.
        second: the second measurement.

    Raises:
        InputError: the measurements share no channel.
    """
    channels = tuple(
        joined_channels((channel, further))
        for channel in first.channels
        for further in second.channels
        if (further.name, further.kind) == (channel.name, channel.kind)
    )
    if not channels:
        raise InputError(f"{second.name}: has no channel that {first.name} has")
    return DataSource(f"{first.name} and {second.name}", channels, first.arm)


def _source_of(data: Any, options: ImportOptions) -> DataSource:  # noqa: ANN401
    match data:
        case DataSource():
            return data
        case str() | os.PathLike():
            return _source_of_file(Path(data), options)
        case ChannelData():
            return _source_of([data], options)
        case list() | tuple() if data and all(isinstance(item, str | os.PathLike) for item in data):
            return _source_of_import(IN_MEMORY, import_files([Path(path) for path in data], options))
        case list() | tuple() if data and all(isinstance(item, ChannelData) for item in data):
            names = [str(channel.name) for channel in data]
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise InputError(f"{IN_MEMORY}: several channels are called {', '.join(twice)}; rename them")
            for channel in data:
                _check_channel(channel)
            return DataSource(IN_MEMORY, tuple(data))
    imported = import_table(table_of(FileColumns(_as_arrow(data)), Path(IN_MEMORY)), options)
    return _source_of_import(IN_MEMORY, imported)


def _check_channel(channel: ChannelData) -> None:
    """Raise an error if a channel that a program made has invalid values or shapes."""
    place = f"channel '{channel.name}'"
    if not (isinstance(channel.name, str) and _CHANNEL_NAME.fullmatch(channel.name)):
        raise InputError(f"channel name {channel.name!r}: give letters, digits and _, such as 'joint_1'")
    if not isinstance(channel.kind, ChannelKind):
        raise InputError(f"{place}: kind {channel.kind!r} is not known. Valid: {', '.join(ChannelKind)}")
    arrays = ("time_s", "position", "velocity", "acceleration", "effort", "run", "phase")
    if wide := [what for what in arrays if getattr(channel, what).ndim != 1]:
        shape = getattr(channel, wide[0]).shape
        raise InputError(f"{place}: {wide[0]} has shape {shape}, expected one value per sample")
    for what in ("run", "phase"):
        if getattr(channel, what).dtype.kind not in "iu":
            raise InputError(f"{place}: {what} holds {getattr(channel, what).dtype}, expected integers")
    if unknown := set(channel.phase.tolist()) - {-1, *Phase}:
        raise InputError(f"{place}: there is no phase {min(unknown)}. Valid: -1 to {max(Phase)}")
    changes = np.flatnonzero(np.diff(channel.run)) + 1
    repeated = np.setdiff1d(np.arange(len(channel)), np.unique(channel.run, return_index=True)[1])
    if len(scattered := np.intersect1d(changes, repeated)):
        run = channel.run[scattered[0]]
        raise InputError(
            f"{place}: run {run} continues at sample {scattered[0]}, after another run; sort the samples"
        )
    late = np.flatnonzero((np.diff(channel.time_s) <= 0.0) & (np.diff(channel.run) == 0))
    if len(late):
        before_s, after_s = channel.time_s[late[0] : late[0] + 2]
        raise InputError(
            f"{place}: time_s {after_s:.9g} of sample {late[0] + 1} does not come after {before_s:.9g}; "
            "times must increase within a run"
        )


def _source_of_import(name: str, imported: ImportedData, path: Path | None = None) -> DataSource:
    unused, notes, read = imported.unused, imported.notes, imported.read
    return DataSource(name, imported.channels, path=path, unused=unused, notes=notes, read=read)


def _source_of_file(path: Path, options: ImportOptions) -> DataSource:
    if path.is_dir() and (any(map(is_session, path.glob("*.mcap"))) or not (files := data_files(path))):
        if options != NO_OPTIONS:
            raise InputError(f"{path}: is a folder of sessions; omit the options for data files")
        from palpate.estimation.study import sessions  # noqa: PLC0415, needs the MCAP library

        (first, *more), channels = sessions.read_folder(path)
        notes = _warnings_of(channels)
        return DataSource(
            path.name, channels, sessions.arm_of(first), path, first, notes=notes, more=tuple(more)
        )
    if path.is_dir():
        return _source_of_import(path.name, import_files(files, options), path)
    if not is_session(path):
        return _source_of_import(path.name, import_file(path, options), path)
    if options != ImportOptions(where={RUN: runs} if (runs := options.where.get(RUN)) else {}):
        raise InputError(
            f"{path}: is a session, which takes --where run=0,2; "
            "--column, --unit, --context, --runs and --fresh-runs are for data files"
        )
    from palpate.estimation.study import sessions  # noqa: PLC0415, needs the MCAP library

    session, channels = sessions.read_session(path, runs or "")
    cut_off = "the session file is cut off at its end; the results use the remaining data"
    notes = (*_warnings_of(channels), *([cut_off] if session.truncated else []))
    return DataSource(path.name, channels, sessions.arm_of(session), path, session, notes=notes)


def _warnings_of(channels: Sequence[ChannelData]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(warning for channel in channels for warning in channel.import_warnings))


def _as_arrow(data: Any) -> pa.Table:  # noqa: ANN401
    """Convert a table of any library, by Arrow's interface or column by column."""
    names = list(data) if isinstance(data, Mapping) else list(getattr(data, "columns", ()))
    if isinstance(data, pa.Table):
        return data
    if hasattr(data, "__arrow_c_stream__"):
        try:
            return pa.table(data)
        except (pa.ArrowException, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{IN_MEMORY}: is not a table: {' '.join(str(error).split())[:200]}") from error
    columns = {}
    for name in names:
        values = data[name]
        if isinstance(values, np.ma.MaskedArray):  # masked values become NaN
            values = np.ma.filled(values.astype(np.float64), np.nan)
        try:
            columns[str(name)] = np.asarray(values)
        except ValueError:  # nested values of different lengths, which `arrow_table` reports
            columns[str(name)] = np.fromiter(values, dtype=object)
    if columns:
        return arrow_table(columns, Path(IN_MEMORY))
    raise InputError(
        f"data of type {type(data).__name__}{' without columns' if isinstance(data, Mapping) else ''}: give "
        "the path of a session or data file, a table (pandas, pyarrow, or a dict of arrays), or channels"
    )
