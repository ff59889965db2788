"""`palpate import`: make a session from anybody's measurements."""

import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from estimation.data.file_kind import is_session
from estimation.data.import_file import Imported
from estimation.data.import_files import data_files, import_files
from estimation.data.session_streams import import_extra, import_streams
from palpate.common import console
from palpate.common.files import existing_file, open_session, output_session
from palpate.common.formatting import as_command, count, duration, shown, typed
from palpate.common.options import takes
from palpate.render.progress import import_progress
from palpate.workflows.data_options import ReadOptions, retyped
from palpate.workflows.import_preview import facts, implausible, look_as_data, look_at
from robot_io.errors import InputError
from robot_io.session import SessionMetadata, write_session

_READ = 0.6  # of the time that an import takes, on reading
_MOST_NAMES = 5  # of files, that the session keeps


@takes(ReadOptions)
def command(
    options: ReadOptions,
    *,
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Measurements: text (.csv ...), .xlsx, .parquet, .npz, a ROS 2 bag; folders of them. "
            "Several are runs of one.",
            metavar="FILE",
        ),
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Session file to write.")] = None,
    look: Annotated[bool, typer.Option("--look", help="Show what would be read, and store nothing.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")] = False,
) -> None:
    """Make a session from files of measurements as a laboratory writes them; one row a sample, named columns.

    A contact needs time, displacement (positive into the object) and force (positive in compression); a joint
    needs time, position and torque. Names in common use are found with their units, and shown.

    Examples: palpate import press.csv --look; palpate import 1.xlsx 2.xlsx -o both.mcap
    """
    found = [file for path in files for file in _data_in(path)]
    if look:
        _look(files, found, options, out, as_json=as_json)
        return
    stem = files[0].name.removesuffix(".gz").rpartition(".")[0] or files[0].stem
    session = output_session(out or Path("sessions") / f"{stem}.mcap")
    with import_progress() as progress:
        imported = import_files(found, options.options, lambda what, share: progress(what, _READ * share))
        write_session(
            session,
            import_streams(imported),
            _metadata(found, imported),
            progress=lambda share: progress("writing the session", _READ + (1.0 - _READ) * share),
        )
    notes = (*imported.notes, *implausible(imported))
    console.say_read(imported.read, notes)
    if as_json:
        console.print_json({"session": str(session), "channels": facts(imported), "notes": list(notes)})
    else:
        _print(imported, session)


def _data_in(path: Path) -> list[Path]:
    """The file, or those in a folder. InputError: there is none, or a session, which needs no import."""
    files = data_files(path) if path.is_dir() else [existing_file(path, "data file")]
    for file in files:
        if is_session(file):
            open_session(file)  # says what is wrong with what is only called one
            raise InputError(f"{file}: is a session already; all commands take it as it is")
    if not files:
        raise InputError(f"{path}: is a folder without a data file")
    return files


def _metadata(files: Sequence[Path], imported: Imported) -> SessionMetadata:
    names = ", ".join(file.name for file in files[:_MOST_NAMES]) + (
        " ..." if len(files) > _MOST_NAMES else ""
    )
    return SessionMetadata(
        software_version=version("palpate"),
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        command_line=as_command(sys.argv[1:]),
        extra={"source": f"imported from {names}"} | import_extra(imported),
    )


def _look(
    named: Sequence[Path], files: Sequence[Path], options: ReadOptions, out: Path | None, *, as_json: bool
) -> None:
    if out is not None:
        raise InputError("--look only shows, and stores nothing: leave out --out")
    if as_json:
        console.print_json({"files": [look_as_data(file, options.options) for file in files]})
        return
    roles = None
    for file in files:
        roles = look_at(file, options.options, roles)
    given = {
        "column": options.column,
        "unit": options.unit,
        "where": options.where,
        "context": options.context,
    }
    runs = None if options.runs is None else str(options.runs)
    more = " ".join(typed(file) for file in named[:-1])
    last = retyped(named[-1], **given, **{"fresh-runs": options.fresh_runs, "runs": runs})
    command = " ".join(filter(None, ["palpate import", more, last]))
    console.next_steps((command, "store it as a session"))


def _print(imported: Imported, session: Path) -> None:
    out = console.stdout()
    for fact in facts(imported):
        samples, runs = count(fact["samples"], "sample"), count(fact["runs"], "run")
        out.print(f"{fact['channel']} ({fact['kind']}): {samples}, {runs}, {duration(fact['recorded_s'])}")
    out.print(f"written: [bold]{shown(session)}[/bold]", soft_wrap=True)
    console.next_steps(
        (f"palpate estimate {typed(session)}", "parameters of a model with their intervals"),
        (f"palpate compare {typed(session)}", "how far off a simple model is, and where"),
        (f"palpate diagnose {typed(session)}", "which physical effect is missing"),
        (f"palpate info {typed(session)}", "what is in the file"),
    )
