"""`palpate merge` and `reveal`: merge sessions, and open sealed answers."""

import filecmp
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from typer import Argument, Option

from palpate.common import console
from palpate.common.console import as_command, count, display_path, shell_path, significant
from palpate.common.files import existing_file, open_session, output_session
from palpate.common.options import JsonOption
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.channels import session_channels
from palpate.estimation.data.tick_channels import join_ticks
from palpate.estimation.effects import EFFECTS
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Session, Stream, write_session
from palpate.robot_io.session.event import NOT_WHOLE, RUN_LABELS
from palpate.runs.hidden_effects import SEAL, open_answer
from palpate.runs.session import SOURCE
from palpate.sim_backend.hidden import SealedAnswer, sealed_path


def merge_command(
    sessions: Annotated[list[Path], Argument(help="Sessions of one arm, or imported sessions, in order.")],
    out: Annotated[Path, Option("--out", "-o", help="Session file to write.")],
    as_json: JsonOption = False,
) -> None:
    """Merge several sessions into one measurement; runs are renumbered.

    Example:
      palpate merge monday.mcap tuesday.mcap -o both.mcap
    """
    if len(sessions) < 2:
        raise InputError(f"{sessions[0]}: only one session; give two or more")
    places = [existing_file(path, "session").resolve() for path in sessions]
    if twice := [str(path) for n, path in enumerate(sessions) if places[n] in places[:n]]:
        raise InputError(f"{twice[0]}: is given twice; its runs would count as repeated measurements")
    for number, path in enumerate(sessions):
        if same := [other for other in sessions[:number] if filecmp.cmp(other, path, shallow=False)]:
            raise InputError(f"{path}: is a copy of {same[0]}; its runs would count as repeated measurements")
    file = output_session(out, keep=sessions)
    opened = [open_session(path) for path in sessions]
    streams = _merged_streams(opened)
    every = [session.metadata for session in opened]
    first, named = every[0], ", ".join(session.path.name for session in opened)
    shared = {
        key: text for key, text in first.extra.items() if all(item.extra.get(key) == text for item in every)
    }
    for key in (SEAL, RUN_LABELS):  # valid for one session and its run numbers only
        shared.pop(key, None)
    if lacking := [session.path.name for session in opened if _is_incomplete(session)]:
        shared[NOT_WHOLE] = ", ".join(lacking)
    metadata = replace(
        first,
        scenario=first.scenario if all(item.scenario == first.scenario for item in every) else "",
        seed=first.seed if all(item.seed == first.seed for item in every) else None,
        command_line=as_command(sys.argv[1:]),
        software_version=version("palpate"),
        extra=shared | {SOURCE: f"{_MERGED}{named}"},
    )
    write_session(file, streams, metadata, [event for session in opened for event in session.events])
    samples = {stream.name: len(columns["time_s"]) for stream, columns in streams}
    console.print_read_notes("", _merge_notes(opened))

    def show() -> None:
        for name, number in samples.items():
            console.stdout().print(f"{name}: {count(number, 'sample')} of {count(len(sessions), 'session')}")
        console.say(f"written: [bold]{display_path(file)}[/bold]")

    console.present(
        {"session": str(file), "merged": [str(path) for path in sessions], "samples": samples},
        show,
        [
            (f"palpate info {shell_path(file)}", "what is in the file"),
            (f"palpate diagnose {shell_path(file)}", "which physical effect is missing"),
        ],
        as_json=as_json,
    )


def reveal_command(
    session: Annotated[Path, Argument(help="Session file (.mcap) that was probed with --hidden.")],
    as_json: JsonOption = False,
) -> None:
    """Reveal which effects were hidden in a session, where, and how strong they are."""
    sealed = open_session(session)
    if (source := sealed.metadata.extra.get(SOURCE, "")).startswith(_MERGED):
        raise InputError(f"{session}: is {source}; reveal each of these sessions")
    answer = SealedAnswer((), None, sealed.metadata.created_utc)
    if SEAL in sealed.metadata.extra or sealed_path(sealed.path).exists():
        answer = open_answer(sealed)
    known = [entry.name for entry in answer.hidden if entry.name in EFFECTS]
    steps = [(f"palpate effects {name}", "what this effect is") for name in known[:1]]
    if answer.hidden:
        steps.append((f"palpate diagnose {shell_path(session)}", "whether a diagnosis finds it"))
    else:
        steps.append(("palpate probe --hidden random -o secret.mcap", "hide an effect"))

    def show() -> None:
        if not answer.hidden:
            name = display_path(session)
            console.say(f"{name} has no hidden effects; only palpate probe --hidden hides effects")
            return
        table = console.table(
            f"Hidden in {display_path(session)}", "effect", "shows in", "parameters", "physics"
        )
        table.columns[0].no_wrap = True
        for entry in answer.hidden:
            values = (
                f"{name} = {significant(value)} {unit}" for name, (value, unit) in entry.values().items()
            )
            physics = (entry.__doc__ or "").partition("\n")[0]
            table.add_row(f"[bold]{entry.name}[/bold]", ", ".join(entry.channels), "\n".join(values), physics)
        console.stdout().print(table)

    hidden = []
    for entry in answer.hidden:
        parameters = {name: {"value": value, "unit": unit} for name, (value, unit) in entry.values().items()}
        hidden.append({"effect": entry.name, "channels": entry.channels, "parameters": parameters})
    content = {"session": str(session), "seed": answer.seed, "hidden": hidden}
    console.present(content, show, steps, as_json=as_json)


RUN = "run"
_MERGED = "merged from "  # begins the source of a merged session, before the names of its parts
_TO_MILLI = 1e3
_BEGUN = 0.05  # share of the force reached in every run, above which the object counts as touched
_APART, _SPREADS = 0.05, 3.0  # share of the deepest indentation, and multiple of the spread between runs
Merged = tuple[Stream, Mapping[str, NDArray[np.generic]]]


def _merged_streams(sessions: Sequence[Session]) -> list[Merged]:
    """Concatenate each stream that all sessions have."""
    first = sessions[0]
    for session in sessions[1:]:  # refuse sessions of other arms, or with other streams or columns
        if session.metadata.urdf != first.metadata.urdf:
            if session.metadata.urdf and first.metadata.urdf:
                raise InputError(
                    f"{session.path}: was not recorded with the arm of {first.path} (their URDFs differ)"
                )
            with_arm, without = ("", " not") if first.metadata.urdf else (" not", "")
            raise InputError(
                f"{session.path}: was{without} recorded with an arm, but {first.path} was{with_arm}; "
                "merge only sessions of the same kind"
            )
        if set(session.stream_names) != set(first.stream_names):
            names = [", ".join(each.stream_names) or "none" for each in (session, first)]
            raise InputError(f"{session.path}: has streams {names[0]}, but {first.path} has {names[1]}")
        for name in first.stream_names:
            streams = [each.samples(name).stream for each in (session, first)]
            forms = [{(c.name, c.width, c.unit) for c in stream.columns} for stream in streams]
            if forms[0] != forms[1]:
                differing = ", ".join(sorted({column for column, *_ in forms[0] ^ forms[1]}))
                raise InputError(
                    f"{session.path}: stream '{name}' differs from the one in {first.path} in columns "
                    f"{differing}"
                )
    merged = list[Merged]()
    for name in sessions[0].stream_names:
        parts = [session.samples(name) for session in sessions]
        if RUN in parts[0]:
            parts = [join_ticks(parts)]
        columns = {column: np.concatenate([part[column] for part in parts]) for column in parts[0]}
        merged.append((parts[0].stream, columns))
    return merged


def _is_incomplete(session: Session) -> bool:
    is_cut = session.truncated or session.unclosed or session.dropped
    return bool(is_cut) or NOT_WHOLE in session.metadata.extra


def _merge_notes(sessions: Sequence[Session]) -> list[str]:
    """Name incomplete sessions, and contacts that begin at another depth than in the first session."""
    notes = [
        f"{session.path.name}: is incomplete (palpate info says why); only its recorded part was merged"
        for session in sessions
        if _is_incomplete(session)
    ]
    try:
        every = [session_channels(session, tared=True) for session in sessions]
    except InputError:  # a session without a channel is not compared
        return notes
    first, *others = (
        {item.name: item for item in channels if item.kind is ChannelKind.CONTACT} for channels in every
    )
    return notes + [
        f"{session.path.name}: {name} begins about {_TO_MILLI * abs(deeper_m):.2g} mm "
        f"{'deeper' if deeper_m > 0.0 else 'higher'} than in {sessions[0].path.name}, but a merged "
        "session has only one surface. Measure displacements from the surface, or compare the two "
        "sessions (palpate compare A B)"
        for session, contacts in zip(sessions[1:], others, strict=True)
        for name in sorted(first.keys() & contacts.keys())
        if (deeper_m := _depth_difference(first[name], contacts[name]))
    ]


def _depth_difference(first: ChannelData, second: ChannelData) -> float:
    """Return how much deeper the second contact begins [m]; 0 if single runs differ by about as much."""
    force_n = _BEGUN * min(
        data.effort[data.run == run].max() for data in (first, second) for run in data.runs
    )
    begins = []  # position along the press direction where each run first exceeds that force [m]
    for contact in (first, second):
        surface_m = 0.0 if contact.surface is None else contact.surface.position_m
        depths = []
        for run in contact.runs:
            rows = np.flatnonzero(contact.run == run)
            up = contact.effort[rows[: int(np.argmax(contact.effort[rows])) + 1]]
            depths.append(contact.position[rows[np.flatnonzero(up <= force_n).max(initial=0)]])
        begins.append(np.array(depths) + surface_m)
    a, b = begins
    deepest = max(float(data.position.max()) for data in (first, second))
    deeper = float(np.median(b) - np.median(a))
    return deeper if abs(deeper) > max(_APART * deepest, _SPREADS * max(np.ptp(a), np.ptp(b))) else 0.0
