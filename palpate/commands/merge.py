"""`palpate merge`: several sessions as one."""

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from palpate.common import console
from palpate.common.files import open_session, output_session
from palpate.common.formatting import as_command, count, shown, typed
from palpate.workflows.data_options import JsonOption
from palpate.workflows.merge_sessions import merged_metadata, merged_streams, not_whole, surfaces_apart
from robot_io.errors import InputError
from robot_io.session import write_session


def command(
    sessions: Annotated[list[Path], typer.Argument(help="Sessions of one arm, or imported ones, in order.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Session file to write.")],
    as_json: JsonOption = False,
) -> None:
    """Make one session of several: their runs go on, so that they are judged as one measurement.

    Example: palpate merge monday.mcap tuesday.mcap -o both.mcap
    """
    if len(sessions) < 2:
        raise InputError(f"{sessions[0]}: is one session; name two or more")
    places = [path.resolve() for path in sessions]
    if twice := [str(path) for n, path in enumerate(sessions) if places[n] in places[:n]]:
        raise InputError(f"{twice[0]}: is named twice; its runs would count as repetitions")
    file = output_session(out, keep=sessions)
    found = [open_session(path) for path in sessions]
    streams = merged_streams(found)
    metadata = merged_metadata(found, as_command(sys.argv[1:]), version("palpate"))
    write_session(file, streams, metadata, [event for session in found for event in session.events])
    samples = {stream.name: len(columns["time_s"]) for stream, columns in streams}
    console.say_read("", [*not_whole(found), *surfaces_apart(found)])
    if as_json:
        console.print_json(
            {"session": str(file), "merged": [str(path) for path in sessions], "samples": samples}
        )
        return
    for name, number in samples.items():
        console.stdout().print(f"{name}: {count(number, 'sample')} of {count(len(sessions), 'session')}")
    console.stdout().print(f"written: [bold]{shown(file)}[/bold]", soft_wrap=True)
    console.next_steps(
        (f"palpate info {typed(file)}", "what is in the file"),
        (f"palpate diagnose {typed(file)}", "which physical effect is missing"),
    )
