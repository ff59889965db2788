"""What a study is about: a session, a data file, or measurements that are in memory already."""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from control.loop.tick_record import STREAM_NAME
from estimation.base_model import ModelContext
from estimation.channel import ChannelData
from estimation.data.array_files import arrow_of
from estimation.data.channels import is_session, session_channels
from estimation.data.import_file import Imported, chosen_texts, import_file, import_table
from estimation.data.import_files import data_files, import_files
from estimation.data.import_options import ImportOptions
from estimation.data.joining import joined_channels
from estimation.data.quantities import RUN
from estimation.data.session_streams import run_labels
from estimation.data.table import table_of
from estimation.fit.long_data import shortened
from robot_io.calibration import NO_CALIBRATIONS, parse_calibrations
from robot_io.errors import InputError
from robot_io.robot_file import parse_robot_file
from robot_io.session import Session
from robot_io.types import IntArray

NO_OPTIONS = ImportOptions()
IN_MEMORY = "data"  # what measurements without a file are called


@dataclass(frozen=True)
class Arm:
    """The arm that was measured."""

    urdf: str = ""  # text of its URDF, empty where it is not known
    tip_frame: str = ""  # the tip's frame in it
    origin: str = "URDF text"  # where the URDF comes from, for errors
    # Shape (3,), fall acceleration in the axes of its base [m/s^2].
    gravity_m_s2: tuple[float, float, float] = NO_CALIBRATIONS.gravity_base_m_s2
    # Shape (n,), what its drives' rotors add to the joints, or empty [kg m^2].
    rotor_inertia_kg_m2: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()  # sentences on it that the reader should see

    def context_of(self, channel: ChannelData) -> ModelContext:
        """What a base model may need to know beside a channel."""
        joint = re.fullmatch(r"joint_(\d+)", channel.name)
        return ModelContext(
            joint=int(joint[1]) - 1 if joint else None,
            urdf=self.urdf,
            tip_frame=self.tip_frame,
            urdf_origin=self.origin,
            gravity_m_s2=self.gravity_m_s2,
            rotor_inertia_kg_m2=self.rotor_inertia_kg_m2,
            surface_found=channel.surface is not None,
        )


NO_ARM = Arm()


@dataclass(frozen=True)
class Source:
    """What was measured."""

    name: str  # of the file, for people
    channels: tuple[ChannelData, ...]  # efforts with their motion, as they were measured
    arm: Arm = NO_ARM  # what the channels belong to
    path: Path | None = None  # session, folder of sessions, or data file; None for measurements in memory
    session: Session | None = None  # the first; None if it is none
    unused: tuple[str, ...] = ()  # columns of numbers that nothing was made of
    notes: tuple[str, ...] = ()  # sentences on the data that the reader should see
    more: tuple[Session, ...] = ()  # further probings by the same arm, that belong to the study
    read: str = ""  # what was taken for what in a data file; empty for a session
    # A sentence for each channel that was too long to be searched as it was recorded, by name.
    averaged: Mapping[str, str] = field(default_factory=dict)
    # Of channels whose runs were cut for that, the run that each stretch is of, by its number.
    stretches: Mapping[str, Mapping[int, int]] = field(default_factory=dict)

    @property
    def probed(self) -> bool:
        """Whether an arm was to touch something."""
        return self.session is not None and STREAM_NAME in self.session.stream_names

    @property
    def runs(self) -> tuple[int, ...]:
        """Numbers of the runs as they were recorded, of all channels."""
        return tuple(sorted({run for one in self.channels for run in self.recorded(one)}))

    def recorded(self, channel: ChannelData) -> list[int]:
        """For each of a channel's runs the one that was recorded: another where it is a stretch of that."""
        run_of = self.stretches.get(channel.name, {})
        return [run_of.get(run, run) for run in channel.runs.tolist()]

    def runs_of(self, channel: ChannelData, recorded: Sequence[int]) -> tuple[int, ...]:
        """Numbers of a channel's runs, or stretches of runs, that were recorded as these."""
        return tuple(channel.runs[np.isin(self.recorded(channel), recorded)].tolist())

    def without(self, runs: Sequence[int]) -> "Source":
        """The source without these runs."""
        left = (one.of_runs(np.setdiff1d(one.runs, self.runs_of(one, runs))) for one in self.channels)
        return replace(self, channels=tuple(left))

    def tared(self) -> tuple[ChannelData, ...]:
        """The channels with the force in free air taken off that of a probing, which a stiffness needs."""
        if self.session is None:
            return self.channels
        return _of_runs(session_channels(self.session, *self.more, tared=True), np.array(self.runs))


def open_source(data: Any, options: ImportOptions = NO_OPTIONS, arm: Arm | None = None) -> Source:  # noqa: ANN401
    """Read whatever a user has.

    Args:
        data: path of a session, of a folder of sessions of one arm, of a data file or of a folder of them,
            or a list of data files, whose runs belong together; a table (pandas, pyarrow, or a dict of arrays
            (n,)), whose columns are called as those of a file; one channel or several.
        options: how to read a file or table; none for a session or channels.
        arm: what the channels belong to, where the data does not say or the user knows better.

    Raises:
        InputError: it cannot be used.
    """
    source = _read(data, options)
    return source if arm is None else replace(source, arm=arm, notes=(*source.notes, *arm.notes))


def limit_length(source: Source, held_out: Sequence[int] = ()) -> Source:
    """The source with long recordings averaged where that loses nothing, and a note on each.

    Args:
        source: what was measured.
        held_out: runs that no model is fitted to.

    Raises:
        InputError: there is no such run.
    """
    if unknown := sorted(set(held_out).difference(source.runs)):
        named = ", ".join(map(str, source.runs))
        raise InputError(f"runs to hold out: there is no run {unknown[0]}. There are: {named}")
    short = [shortened(channel, source.runs_of(channel, held_out)) for channel in source.channels]
    said = {channel.name: words for channel, words, _ in short if words}
    return replace(
        source,
        channels=tuple(channel for channel, _, _ in short),
        averaged={**source.averaged, **said},
        notes=(*source.notes, *said.values()),
        stretches={**source.stretches, **{channel.name: cut for channel, _, cut in short if cut}},
    )


def joined(first: Source, second: Source) -> Source:
    """Two measurements of one thing as one, the runs of the second after those of the first; in memory.

    Raises:
        InputError: they share no channel.
    """
    others = {(one.name, one.kind): one for one in second.channels}
    pairs = [(one, others.get((one.name, one.kind))) for one in first.channels]
    channels = tuple(joined_channels((one, other)) for one, other in pairs if other is not None)
    if not channels:
        raise InputError(f"{second.name}: has no channel that {first.name} has")
    return Source(f"{first.name} and {second.name}", channels, first.arm)


def _read(data: Any, options: ImportOptions) -> Source:  # noqa: ANN401
    match data:
        case Source():
            return data
        case str() | os.PathLike():
            return _of_file(Path(data), options)
        case ChannelData():
            return Source(IN_MEMORY, (data,))
        case list() | tuple() if data and all(isinstance(one, str | os.PathLike) for one in data):
            return _of_import(IN_MEMORY, import_files([Path(one) for one in data], options))
        case list() | tuple() if data and all(isinstance(one, ChannelData) for one in data):
            names = [one.name for one in data]
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise InputError(f"{IN_MEMORY}: several channels are called {', '.join(twice)}; rename them")
            return Source(IN_MEMORY, tuple(data))
    imported = import_table(table_of(_arrow(data), Path(IN_MEMORY)), options)
    return _of_import(IN_MEMORY, imported)


def _of_import(name: str, imported: Imported, path: Path | None = None) -> Source:
    return Source(
        name,
        imported.channels,
        path=path,
        unused=imported.unused,
        notes=imported.notes,
        read=imported.read,
    )


def _of_folder(folder: Path) -> Source:
    """The probings in a folder, as one measurement."""
    sessions = [Session.open(path) for path in sorted(folder.glob("*.mcap"))]
    if not sessions:
        raise InputError(f"{folder}: is a folder without a session (.mcap) or a data file")
    first, *more = sessions
    channels = session_channels(first, *more)
    return Source(folder.name, channels, arm_of(first), folder, first, more=tuple(more))


def _of_file(path: Path, options: ImportOptions) -> Source:
    if path.is_dir() and (any(map(is_session, path.glob("*.mcap"))) or not (files := data_files(path))):
        if options != NO_OPTIONS:
            raise InputError(f"{path}: is a folder of sessions, whose options are those of their import")
        return _of_folder(path)
    if path.is_dir():
        return _of_import(path.name, import_files(files, options), path)
    if not is_session(path):
        return _of_import(path.name, import_file(path, options), path)
    if options != ImportOptions(where={RUN: runs} if (runs := options.where.get(RUN)) else {}):
        raise InputError(
            f"{path}: is a session, which takes --where run=0,2; "
            "--column, --unit, --context, --runs and --fresh-runs are for data files"
        )
    session = Session.open(path)
    channels = session_channels(session)
    if runs:
        named = _named_runs(session, channels)
        numbers = [named[text] for text in chosen_texts(RUN, runs, named, str(path))]
        channels = _of_runs(channels, np.array(numbers))
    return Source(path.name, channels, arm_of(session), path, session)


def _named_runs(session: Session, channels: Iterable[ChannelData]) -> dict[str, int]:
    """Number of each run by what it is called: in the data file that it was imported from, or its number.

    A number that is another run's name says neither.
    """
    there = sorted(set(chain(*(one.runs.tolist() for one in channels))))
    called = {label: run for label, run in run_labels(session).items() if run in there}
    unnamed = {str(run): run for run in there}
    return {
        name: run
        for name, run in (unnamed | called).items()
        if unnamed.get(name, run) == called.get(name, run)
    }


def _of_runs(channels: Iterable[ChannelData], runs: IntArray) -> tuple[ChannelData, ...]:
    """What of the channels is of these runs."""
    chosen = (one.of_runs(runs) for one in channels)
    return tuple(one for one in chosen if len(one))


def _arrow(data: Any) -> pa.Table:  # noqa: ANN401
    """A table of any library: by Arrow's own interface, else column by column."""
    names = list(data) if isinstance(data, Mapping) else list(getattr(data, "columns", ()))
    if isinstance(data, pa.Table):
        return data
    if hasattr(data, "__arrow_c_stream__"):
        try:
            return pa.table(data)
        except (pa.ArrowException, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{IN_MEMORY}: is no table: {' '.join(str(error).split())[:200]}") from error
    if names:
        return arrow_of({str(name): _plain(data[name]) for name in names}, Path(IN_MEMORY))
    raise InputError(
        f"data of type {type(data).__name__}{' without columns' if isinstance(data, Mapping) else ''}: give "
        "the path of a session or data file, a table (pandas, pyarrow, or a dict of arrays), or channels"
    )


def _plain(values: Any) -> np.ndarray[Any, Any]:  # noqa: ANN401
    """An array of a column; what is masked is no number."""
    if isinstance(values, np.ma.MaskedArray):
        return np.asarray(np.ma.filled(values.astype(np.float64), np.nan))
    return np.asarray(values)


def arm_of(session: Session) -> Arm:
    """The arm as the session keeps it. InputError: its copy of the robot file is not valid."""
    text = session.metadata.robot_file
    robot_file = parse_robot_file(text, f"{session.path}, its robot file") if text else None
    tip_frame = robot_file.tip_frame if robot_file else ""
    rotors = robot_file.rotor_inertia_kg_m2 if robot_file else None
    calibrations = parse_calibrations(session.metadata.calibration, f"{session.path}, its calibration")
    origin = f"{session.path}, its URDF"
    return Arm(session.metadata.urdf, tip_frame, origin, calibrations.gravity_base_m_s2, rotors or ())
