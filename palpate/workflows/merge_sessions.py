"""Several sessions as one: their runs go on, one session after the other."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.channel import ChannelData, ChannelKind
from estimation.data.channels import session_channels
from estimation.data.session_streams import RUN_LABELS
from estimation.data.tick_channels import joined
from palpate.runs.hidden_effects import SEAL
from palpate.runs.session import NOT_WHOLE, SOURCE
from robot_io.errors import InputError
from robot_io.session import Session, SessionMetadata, Stream
from robot_io.types import FloatArray

RUN = "run"
_MILLI = 1e3
_BEGUN = 0.05  # of the force that every run reaches: with it, an object is touched
_APART, _SPREADS = 0.05, 3.0  # of the deepest indentation, and of what runs of one session differ by
Merged = tuple[Stream, Mapping[str, NDArray[np.generic]]]


def merged_streams(sessions: Sequence[Session]) -> list[Merged]:
    """Each stream that all sessions have, one session's samples after the other's.

    Clocks stay as they are: where one goes on through all sessions, the object remembers what was before.

    Raises:
        InputError: they are not of one arm, or not of the same streams.
    """
    _check(sessions)
    merged = list[Merged]()
    for name in sessions[0].stream_names:
        parts = [session.samples(name) for session in sessions]
        if RUN in parts[0]:
            parts = [joined(parts)]
        columns = {column: np.concatenate([part[column] for part in parts]) for column in parts[0]}
        merged.append((parts[0].stream, columns))
    return merged


def merged_metadata(sessions: Sequence[Session], command_line: str, software_version: str) -> SessionMetadata:
    """What is said of the first, as far as it is true of all.

    Args:
        sessions: in order.
        command_line: how the program was started.
        software_version: of palpate.
    """
    first, files = sessions[0].metadata, ", ".join(session.path.name for session in sessions)
    every = [session.metadata for session in sessions]
    shared = {
        key: text for key, text in first.extra.items() if all(one.extra.get(key) == text for one in every)
    }
    for key in (SEAL, RUN_LABELS):  # of one session, or of the numbers that its runs had
        shared.pop(key, None)
    return replace(
        first,
        scenario=first.scenario if all(one.scenario == first.scenario for one in every) else "",
        seed=first.seed if all(one.seed == first.seed for one in every) else None,
        command_line=command_line,
        software_version=software_version,
        extra=shared | {SOURCE: f"merged from {files}"} | _lacking(sessions),
    )


def not_whole(sessions: Sequence[Session]) -> list[str]:
    """Which sessions lack something, in one sentence each: what is merged of them does not show it."""
    return [
        f"{session.path.name}: is not whole (palpate info says why), and only what is there was merged"
        for session in sessions
        if _lacking([session])
    ]


def _lacking(sessions: Sequence[Session]) -> dict[str, str]:
    """Which sessions lack something, or were merged from such, as metadata; nothing if none does."""
    lacking = [
        session.path.name
        for session in sessions
        if session.truncated or session.unclosed or session.dropped or NOT_WHOLE in session.metadata.extra
    ]
    return {NOT_WHOLE: ", ".join(lacking)} if lacking else {}


def surfaces_apart(sessions: Sequence[Session]) -> list[str]:
    """Which contacts begin at another depth than in the first session, in one sentence each.

    A merged session is judged as presses onto one surface: nothing is shifted.
    """
    try:
        first, *others = map(_contacts, sessions)
    except InputError:  # of one that holds no channel, nothing is judged
        return []
    return [
        f"{session.path.name}: {name} begins about {_MILLI * abs(deeper_m):.2g} mm "
        f"{'deeper' if deeper_m > 0.0 else 'higher'} than in {sessions[0].path.name}, but all are judged as "
        "presses onto one surface: let displacements count from it, or put the two side by side (palpate "
        "compare A B)"
        for session, contacts in zip(sessions[1:], others, strict=True)
        for name in sorted(first.keys() & contacts.keys())
        if (deeper_m := _deeper(first[name], contacts[name]))
    ]


def _contacts(session: Session) -> dict[str, ChannelData]:
    channels = session_channels(session, tared=True)
    return {channel.name: channel for channel in channels if channel.kind is ChannelKind.CONTACT}


def _deeper(first: ChannelData, second: ChannelData) -> float:
    """By how much deeper the second is touched than the first [m]; 0 where runs differ by about as much."""
    force_n = _BEGUN * min(one.effort[one.run == run].max() for one in (first, second) for run in one.runs)
    a, b = (_begins(one, force_n) for one in (first, second))
    deepest = max(float(one.position.max()) for one in (first, second))
    deeper = float(np.median(b) - np.median(a))
    return deeper if abs(deeper) > max(_APART * deepest, _SPREADS * max(np.ptp(a), np.ptp(b))) else 0.0


def _begins(contact: ChannelData, force_n: float) -> FloatArray:
    """Where along the press direction each run exceeds a force on its way to the highest [m]."""
    found = []
    for run in contact.runs:
        rows = np.flatnonzero(contact.run == run)
        up = contact.effort[rows[: int(np.argmax(contact.effort[rows])) + 1]]
        found.append(contact.position[rows[np.flatnonzero(up <= force_n).max(initial=0)]])
    return np.array(found) + (0.0 if contact.surface is None else contact.surface.position_m)


def _check(sessions: Sequence[Session]) -> None:
    first = sessions[0]
    for session in sessions[1:]:
        if session.metadata.urdf != first.metadata.urdf:
            raise InputError(f"{session.path}: {_other_arm(session, first)}")
        if set(session.stream_names) != set(first.stream_names):
            there = [", ".join(each.stream_names) or "none" for each in (session, first)]
            raise InputError(f"{session.path}: has streams {there[0]}, and {first.path} has {there[1]}")
        for name in first.stream_names:
            _check_columns(session, first, name)


def _other_arm(session: Session, first: Session) -> str:
    if not session.metadata.urdf or not first.metadata.urdf:
        with_arm, without = ("", " not") if first.metadata.urdf else (" not", "")
        return f"was{without} made by an arm, and {first.path} was{with_arm}; merge like with like"
    return f"was made by another arm than {first.path} (their URDFs differ)"


def _check_columns(session: Session, first: Session, name: str) -> None:
    forms = [
        {(c.name, c.width, c.unit) for c in each.samples(name).stream.columns} for each in (session, first)
    ]
    if forms[0] != forms[1]:
        differing = ", ".join(sorted({column for column, *_ in forms[0] ^ forms[1]}))
        raise InputError(
            f"{session.path}: stream '{name}' has other columns than in {first.path}: {differing}"
        )
