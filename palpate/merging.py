"""Several sessions as one: their runs go on, one session after the other."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.data.session_streams import RUN_LABELS
from estimation.data.tick_channels import joined
from palpate.runs.hiding import SEAL
from palpate.runs.session import SOURCE
from robot_io.errors import InputError
from robot_io.session import Session, SessionMetadata, Stream

RUN = "run"
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
        extra=shared | {SOURCE: f"merged from {files}"},
    )


def _check(sessions: Sequence[Session]) -> None:
    first = sessions[0]
    for one in sessions[1:]:
        if one.metadata.urdf != first.metadata.urdf:
            raise InputError(f"{one.path}: {_other_arm(one, first)}")
        if set(one.stream_names) != set(first.stream_names):
            there = [", ".join(each.stream_names) or "none" for each in (one, first)]
            raise InputError(f"{one.path}: has streams {there[0]}, and {first.path} has {there[1]}")
        for name in first.stream_names:
            _check_columns(one, first, name)


def _other_arm(one: Session, first: Session) -> str:
    if not one.metadata.urdf or not first.metadata.urdf:
        with_arm, without = ("", " not") if first.metadata.urdf else (" not", "")
        return f"was{without} made by an arm, and {first.path} was{with_arm}; merge like with like"
    return f"was made by another arm than {first.path} (their URDFs differ)"


def _check_columns(one: Session, first: Session, name: str) -> None:
    forms = [{(c.name, c.width, c.unit) for c in each.samples(name).stream.columns} for each in (one, first)]
    if forms[0] != forms[1]:
        differing = ", ".join(sorted({column for column, *_ in forms[0] ^ forms[1]}))
        raise InputError(f"{one.path}: stream '{name}' has other columns than in {first.path}: {differing}")
