"""`palpate import`: make a session from anybody's measurements."""

import shlex
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from estimation.data.import_file import Imported, import_file
from estimation.data.session_streams import import_extra, import_streams
from palpate import console
from palpate.data_options import ReadOptions
from palpate.files import existing_file, output_file
from palpate.option_sets import takes
from palpate.words import count, duration, shown, typed
from robot_io.session import SessionMetadata, write_session


@takes(ReadOptions)
def command(
    options: ReadOptions,
    *,
    file: Annotated[Path, typer.Argument(help="Measurements: .csv, .csv.gz, .parquet or .npz.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Session file to write.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")] = False,
) -> None:
    """Make a session from a file of measurements; one row a sample, a header that names the columns.

    A contact needs time_s, displacement_m (positive into the object) and force_N (positive in compression);
    a joint needs time_s, position_rad and torque_Nm. Velocity, acceleration, run and phase are optional.
    """
    existing_file(file, "data file")
    session = output_file(out or Path("sessions") / f"{_stem(file)}.mcap")
    imported = import_file(file, options.options)
    metadata = SessionMetadata(
        software_version=version("palpate"),
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        command_line=shlex.join(["palpate", *sys.argv[1:]]),
        extra={"source": f"imported from {file.name}"} | import_extra(imported),
    )
    write_session(session, import_streams(imported), metadata)
    console.say_read(imported.read, imported.notes)
    if as_json:
        console.print_json(
            {"session": str(session), "channels": _facts(imported), "notes": list(imported.notes)}
        )
    else:
        _print(imported, session)


def _stem(file: Path) -> str:
    """The file's name without its endings (two of "x.csv.gz")."""
    return file.name.removesuffix(".gz").rpartition(".")[0] or file.stem


def _facts(imported: Imported) -> list[dict[str, Any]]:
    return [
        {
            "channel": channel.name,
            "kind": str(channel.kind),
            "samples": len(channel),
            "runs": len(channel.runs),
            "recorded_s": sum(float(np.ptp(channel.time_s[channel.run == run])) for run in channel.runs),
        }
        for channel in imported.channels
    ]


def _print(imported: Imported, session: Path) -> None:
    out = console.stdout()
    for fact in _facts(imported):
        samples, runs = count(fact["samples"], "sample"), count(fact["runs"], "run")
        out.print(f"{fact['channel']} ({fact['kind']}): {samples}, {runs}, {duration(fact['recorded_s'])}")
    out.print(f"written: [bold]{shown(session)}[/bold]", soft_wrap=True)
    console.next_steps(
        (f"palpate estimate {typed(session)}", "parameters of a model with their intervals"),
        (f"palpate compare {typed(session)}", "how far off a simple model is, and where"),
        (f"palpate diagnose {typed(session)}", "which physical effect is missing"),
        (f"palpate info {typed(session)}", "what is in the file"),
    )
