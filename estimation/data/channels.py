"""Channels of probing sessions and imported sessions, and the streams that store imported channels."""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from palpate.control.loop.tick_record import STREAM_NAME
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.column_names import PROXIES, si_unit
from palpate.estimation.data.contact import STEP_COLUMN, SURFACE_COLUMN, with_surface
from palpate.estimation.data.import_file import ImportedData, with_arm
from palpate.estimation.data.tick_channels import checked_ticks, contact_channels, join_ticks, joint_channels
from palpate.estimation.data.units import MIN_INCREASE_S, describe_fault, invalid_rows
from palpate.estimation.signals.runwise import sample_time
from palpate.robot_io.errors import InputError, SessionError
from palpate.robot_io.session import Column, Samples, Session, Stream
from palpate.robot_io.session.event import RUN_LABELS

_NUMBER = re.compile("[0-9]{1,18}$")
_TOUCHING = "touching"  # column that marks samples in contact at any depth
_CONTEXT = "context_"  # prefix of the names of context signals

COLUMNS = {  # position, velocity, acceleration and effort
    ChannelKind.CONTACT: ("displacement_m", "velocity_m_s", "acceleration_m_s2", "force_n"),
    ChannelKind.REVOLUTE: ("position_rad", "velocity_rad_s", "acceleration_rad_s2", "torque_nm"),
    ChannelKind.SERVO: ("position_rad", "velocity_rad_s", "acceleration_rad_s2", "goal_error_rad"),
    ChannelKind.PRISMATIC: ("position_m", "velocity_m_s", "acceleration_m_s2", "force_n"),
}
_DOCS = {
    "displacement_m": "into the object",
    "force_n": "positive in compression, or along the joint",
    "torque_nm": "positive along the joint axis",
    "goal_error_rad": "goal minus position",
}


def import_streams(imported: ImportedData) -> list[tuple[Stream, Mapping[str, ArrayLike]]]:
    """Convert each imported channel to a stream and its columns, for `write_session`.

    Args:
        imported: result of `import_file`.
    """
    streams = list[tuple[Stream, Mapping[str, ArrayLike]]]()
    for channel in imported.channels:
        unit = channel.position_unit
        units = (unit, f"{unit}/s", f"{unit}/s^2", channel.effort_unit)
        motion = (channel.position, channel.velocity, channel.acceleration, channel.effort)
        phase = Column("phase", "1", 1, "as in the stream of ticks; -1 where unknown", "int32")
        columns: list[tuple[Column, ArrayLike]] = [
            (Column("time_s", "s", 1, "increasing within a run"), channel.time_s),
            (Column("run", "1", 1, "number of the run", "int64"), channel.run),
            (phase, channel.phase.astype(np.int32)),
        ]
        for name, unit, values in zip(COLUMNS[channel.kind], units, motion, strict=True):
            columns.append((Column(name, unit, 1, _DOCS.get(name, "")), values))
        if channel.touching is not None:
            touching = Column(_TOUCHING, "1", 1, "1 where the object pulls as well as pushes", "int32")
            columns.append((touching, channel.touching.astype(np.int32)))
        if channel.surface is not None:
            surface = Column(SURFACE_COLUMN, "m", 1, "estimated surface, from which displacement_m counts")
            step = Column(STEP_COLUMN, "m", 1, "resolution of the displacement")
            columns.append((surface, np.full(len(channel), channel.surface.position_m)))
            columns.append((step, np.full(len(channel), channel.position_step)))
        for name in sorted(channel.recorded):
            columns.append((Column(_CONTEXT + name, "1", 1, "as in the data file"), channel.context[name]))
        stream = Stream(channel.name, tuple(column for column, _ in columns))
        streams.append((stream, {column.name: values for column, values in columns}))
    return streams


def import_extra(imported: ImportedData) -> dict[str, str]:
    """Return the metadata of an imported session: the names of its runs.

    Args:
        imported: result of `import_file`.
    """
    return {RUN_LABELS: json.dumps(imported.run_labels)}


def run_labels(session: Session) -> dict[str, int]:
    """Return the run numbers by the runs' labels in the data file; empty if there are no valid labels.

    Args:
        session: imported session.
    """
    try:
        labels = json.loads(session.metadata.extra.get(RUN_LABELS, "{}"))
    except (ValueError, RecursionError):
        return {}
    pairs = labels.items() if isinstance(labels, dict) else ()
    return {label: int(run) for run, label in pairs if isinstance(label, str) and _NUMBER.match(run)}


def _imported_channel(name: str, samples: Samples) -> ChannelData:
    kinds = [kind for kind, columns in COLUMNS.items() if all(column in samples for column in columns)]
    if not kinds:
        raise SessionError(f"stream '{name}' is not a channel: its columns are {', '.join(samples)}")
    _check(name, samples, ("time_s", "run", "phase", *COLUMNS[kinds[0]]))
    late = np.diff(samples["time_s"]) < MIN_INCREASE_S  # the same limit as in the import
    if (late & (np.diff(samples["run"]) == 0)).any():
        raise InputError(f"stream '{name}', column 'time_s': times must increase within a run")
    context = {
        column.removeprefix(_CONTEXT): samples[column] for column in samples if column.startswith(_CONTEXT)
    }
    if _TOUCHING in samples:
        _check(name, samples, (_TOUCHING,))
    position, velocity, acceleration, effort = (samples[column] for column in COLUMNS[kinds[0]])
    motion, phase = (samples["time_s"], position, velocity, acceleration), samples["phase"].astype(np.int64)
    touching = samples[_TOUCHING] != 0 if _TOUCHING in samples else None
    data = ChannelData(name, kinds[0], *motion, effort, samples["run"], phase, context, touching=touching)
    position_name, *_, effort_name = COLUMNS[kinds[0]]
    stored = {column.name: column.unit for column in samples.stream.columns}
    named = {"position": stored[position_name], "effort": stored[effort_name]}
    proxies = {what: unit for what, unit in named.items() if unit in map(si_unit, PROXIES)}
    data = replace(data, recorded=frozenset(context), proxy_units=proxies)
    if SURFACE_COLUMN not in samples:
        return data
    names = [column for column in (SURFACE_COLUMN, STEP_COLUMN) if column in samples]
    _check(name, samples, names)
    return with_surface(data, *(float(samples[column][0]) for column in names))


def _check(name: str, samples: Samples, columns: Iterable[str]) -> None:
    """Raise an error if a column is missing, has another shape, or has invalid values."""
    for column in columns:
        if column not in samples:
            raise SessionError(f"stream '{name}': no column '{column}'")
        values = samples[column]
        if values.ndim != 1 or values.dtype.kind not in "iuf":
            raise SessionError(f"stream '{name}', column '{column}': expected one number per row")
        bad = invalid_rows(values)
        if len(bad):
            number = float(values[bad[0]])
            fault = describe_fault(number, len(bad))
            raise InputError(f"stream '{name}', row {bad[0] + 1}, column '{column}': {number:g} is {fault}")


def session_channels(
    session: Session, *more: Session, tared: bool = False, joints: bool = True
) -> tuple[ChannelData, ...]:
    """Return the channels of one session, or of several probing sessions of one arm; contacts come first.

    Args:
        session: probing session or imported session.
        more: further probing sessions of the same arm; their run numbers continue.
        tared: subtract the force in free air from the contact force, as the estimation of a stiffness needs;
            False to keep the measured force, as the search for a sensor's bias needs. Imported channels are
            unchanged.
        joints: whether to return the joints of a probing session, which need most of the memory.

    Raises:
        InputError: the session has no channels, or the sessions cannot be joined.
    """
    names = [name for name in session.stream_names if name == "contact" or name.startswith("joint_")]
    try:
        parts = [(name, session.samples(name)) for name in names]
        channels = with_arm([_imported_channel(name, samples) for name, samples in parts if len(samples)])
    except InputError as error:
        raise InputError(f"{session.path}, {error}") from error
    if more or STREAM_NAME in session.stream_names:
        for probing in (session, *more):
            if STREAM_NAME not in probing.stream_names:
                raise InputError(f"{probing.path}: is not a probing session and cannot be joined with others")
            if probing.metadata.urdf != session.metadata.urdf:
                by = f"was not recorded with the arm of {session.path} (their URDFs differ)"
                raise InputError(f"{probing.path}: {by}")
        ticks = join_ticks([checked_ticks(probing) for probing in (session, *more)])
        channels = (*contact_channels(ticks, tared=tared), *(joint_channels(ticks) if joints else ()))
    if not channels:
        streams = ", ".join(session.stream_names) or "none"
        raise InputError(f"{session.path}: no stream holds samples of a run; its streams: {streams}")
    for channel in channels:
        if not sample_time(channel.time_s, channel.run) > 0.0:
            reason = "do not increase from sample to sample"
            raise InputError(f"{session.path}: the times of '{channel.name}' {reason}")
    return channels
