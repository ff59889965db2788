"""`palpate merge` and `reveal`: merge sessions, and open sealed answers."""

import filecmp
import sys
from pathlib import Path
from typing import Annotated

import typer

from palpate.common import console
from palpate.common.console import as_command, count, display_path, shell_path, significant
from palpate.common.files import existing_file, open_session, output_session
from palpate.common.options import JsonOption
from palpate.estimation.effects import EFFECTS
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import write_session
from palpate.runs.hidden_effects import open_answer, was_sealed
from palpate.sim_backend.hidden import SealedAnswer
from palpate.workflows.merge import merge_notes, merged_metadata, merged_streams


def merge_command(
    sessions: Annotated[list[Path], typer.Argument(help="Sessions of one arm, or imported ones, in order.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Session file to write.")],
    as_json: JsonOption = False,
) -> None:
    """Merge several sessions into one measurement; runs are renumbered.

    Example: palpate merge monday.mcap tuesday.mcap -o both.mcap
    """
    if len(sessions) < 2:
        raise InputError(f"{sessions[0]}: is one session; name two or more")
    places = [existing_file(path, "session").resolve() for path in sessions]
    if twice := [str(path) for n, path in enumerate(sessions) if places[n] in places[:n]]:
        raise InputError(f"{twice[0]}: is given twice; its runs would count as repeated measurements")
    for number, path in enumerate(sessions):
        if same := [other for other in sessions[:number] if filecmp.cmp(other, path, shallow=False)]:
            raise InputError(f"{path}: is a copy of {same[0]}; its runs would count as repeated measurements")
    file = output_session(out, keep=sessions)
    opened = [open_session(path) for path in sessions]
    streams = merged_streams(opened)
    metadata = merged_metadata(opened, as_command(sys.argv[1:]))
    write_session(file, streams, metadata, [event for session in opened for event in session.events])
    samples = {stream.name: len(columns["time_s"]) for stream, columns in streams}
    console.print_read_notes("", merge_notes(opened))

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
    session: Annotated[Path, typer.Argument(help="Session file (.mcap) that was probed with --hidden.")],
    as_json: JsonOption = False,
) -> None:
    """Reveal which effects were hidden in a session, where, and how strong they are."""
    sealed = open_session(session)
    answer = (
        open_answer(sealed) if was_sealed(sealed) else SealedAnswer((), None, sealed.metadata.created_utc)
    )
    known = [entry.name for entry in answer.hidden if entry.name in EFFECTS]
    steps = [(f"palpate effects {name}", "what this effect is") for name in known[:1]]
    if answer.hidden:
        steps.append((f"palpate diagnose {shell_path(session)}", "whether a diagnosis finds it"))
    else:
        steps.append(("palpate probe --hidden random -o secret.mcap", "hide an effect"))

    def show() -> None:
        if not answer.hidden:
            remark = "nothing was hidden with palpate probe --hidden"
            console.say(f"no hidden effects are stored with {display_path(session)}: {remark}")
            return
        table = console.table(
            f"Hidden in {display_path(session)}", "effect", "shows in", "parameters", "physics"
        )
        for entry in answer.hidden:
            values = (
                f"{name} = {significant(value)} {unit}" for name, (value, unit) in entry.values().items()
            )
            physics = (entry.__doc__ or "").partition("\n")[0]
            table.add_row(f"[bold]{entry.name}[/bold]", ", ".join(entry.channels), "\n".join(values), physics)
        console.stdout().print(table)

    content = {
        "session": str(session),
        "seed": answer.seed,
        "hidden": [
            {
                "effect": entry.name,
                "channels": entry.channels,
                "parameters": {
                    name: {"value": value, "unit": unit} for name, (value, unit) in entry.values().items()
                },
            }
            for entry in answer.hidden
        ],
    }
    console.present(content, show, steps, as_json=as_json)
