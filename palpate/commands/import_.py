"""`palpate import`: convert measurements from data files to a session."""

import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.table import Table as Printed
from typer import Argument, Option

from palpate.common import console
from palpate.common.console import as_command, count, display_path, duration, safe, shell_path
from palpate.common.files import existing_file, open_session, output_session
from palpate.common.options import JsonOption, SessionOutOption, with_options
from palpate.control.loop.task import Phase
from palpate.estimation.data.channels import import_extra, import_streams
from palpate.estimation.data.file_columns import is_session, list_first
from palpate.estimation.data.import_file import ImportedData, import_table
from palpate.estimation.data.import_files import data_files, import_files, joined_by_signs, read_tables
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import Table
from palpate.estimation.data_quality import list_warnings, quality_warnings, unchanging
from palpate.estimation.estimate import rounded
from palpate.estimation.signals.runwise import sample_time
from palpate.render.palette import phase
from palpate.render.progress import progress_bar
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import SessionMetadata, write_session
from palpate.workflows.data_options import ReadOptions, shell_options

_READ = 0.6  # share of the import's time spent on reading
_MOST_NAMES = 5  # largest number of file names stored in the session


_FILES = (
    "Measurements: text (.csv ...), .xlsx, .mat, .h5, .parquet, a ROS 2 bag, or a folder of these. "
    "Several files are runs of one measurement."
)


@with_options(ReadOptions)
def import_command(
    options: ReadOptions,
    *,
    files: Annotated[list[Path], Argument(help=_FILES, metavar="FILE")],
    out: SessionOutOption = None,
    look: Annotated[bool, Option("--look", help="Show what would be read, without storing it.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Convert measurement files to a session; a table must have one row per sample.

    A contact needs time, displacement (positive into the object) and force (positive in compression); a joint
    needs time, position and torque. Common column names and units are recognized and reported. Columns
    without a name are called 'column 1', 'column 2' and so on; assign them with --column.

    Examples:
      palpate import press.csv --look
      palpate import 1.xlsx 2.xlsx -o both.mcap
    """
    tables: list[Path] = []
    for path in files:
        inside = data_files(path) if path.is_dir() else [existing_file(path, "data file")]
        for file in inside:
            if is_session(file):
                open_session(file)  # raises for a file that only has a session's name
                raise InputError(f"{file}: is already a session; all commands read it directly")
        if not inside:
            raise InputError(f"{path}: is a folder without a data file")
        tables += inside
    if look:
        if out is not None:
            raise InputError("--look stores nothing, so leave out --out")
        if as_json:
            read = [
                (each, import_table(each, options.options)) for each in read_tables(tables, options.options)
            ]
            if joined := joined_by_signs([part for _, part in read], tables, options.options):
                read.append((joined, import_table(joined, options.options)))
            facts = [
                {
                    "file": str(table.path),
                    "rows": len(table),
                    "written": table.notes,
                    "columns": {name: imported.roles.get(name) for name in table.names},
                    "channels": _channel_facts(imported),
                    "notes": [*imported.notes, *_plausibility_warnings(imported)],
                }
                for table, imported in read
            ]
            console.print_json({"files": facts})
            return
        previews: list[ImportedData] = []
        for table in read_tables(tables, options.options):
            previews.append(_print_preview(table, options.options, previews[-1].roles if previews else None))
        if joined := joined_by_signs(previews, tables, options.options):
            previews = [_print_preview(joined, options.options)]
        # Several files are runs of one measurement, so whether they suffice is judged for all together.
        imported = previews[0] if len(previews) == 1 else import_files(tables, options.options)
        for warning in _plausibility_warnings(imported):
            console.stdout().print(f"[yellow]{safe(warning)}[/yellow]")
        words = [*map(shell_path, files[:-1]), shell_options(files[-1], **options.given(ReadOptions))]
        console.next_steps((" ".join(["palpate import", *words]), "store it as a session"))
        return
    stem = files[0].name.removesuffix(".gz").rpartition(".")[0] or files[0].stem
    session = output_session(out or Path("sessions") / f"{stem}.mcap")
    names = list_first([file.name for file in tables], _MOST_NAMES)
    with progress_bar("reading") as bar:
        imported = import_files(tables, options.options, lambda what, share: bar.update(_READ * share, what))
        write_session(
            session,
            import_streams(imported),
            SessionMetadata(
                software_version=version("palpate"),
                created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
                command_line=as_command(sys.argv[1:]),
                extra={"source": f"imported from {names}"} | import_extra(imported),
            ),
            progress=lambda share: bar.update(_READ + (1.0 - _READ) * share, "writing the session"),
        )
    notes = (*imported.notes, *_plausibility_warnings(imported))
    console.print_read_notes(imported.read, notes)

    def show() -> None:
        for fact in _channel_facts(imported):
            samples, runs = count(fact["samples"], "sample"), count(fact["runs"], "run")
            lasts = duration(fact["recorded_s"])
            title = safe(imported.title(fact["channel"]))
            console.say(f"{title} ({fact['kind']}): {samples}, {runs}, {lasts}")
        console.say(f"written: [bold]{display_path(session)}[/bold]")

    content = {"session": str(session), "channels": _channel_facts(imported), "notes": list(notes)}
    steps = (
        (f"palpate estimate {shell_path(session)}", "parameters of a model with their intervals"),
        (f"palpate compare {shell_path(session)}", "how well a simple model fits, and where it fails"),
        (f"palpate diagnose {shell_path(session)}", "which physical effect is missing"),
        (f"palpate info {shell_path(session)}", "what is in the file"),
    )
    console.present(content, show, steps, as_json=as_json)


_VALUES = 3  # number of values shown of each column
_MOST_COLUMNS = 60
_MOST_RUNS = 30
_PAUSE = 10.0  # multiple of the usual time step above which a gap is a pause


def _channel_facts(imported: ImportedData) -> list[dict[str, Any]]:
    """Return kind, samples, runs and length of each channel, as plain data."""
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


def _print_preview(
    table: Table, options: ImportOptions, like: Mapping[str, str] | None = None
) -> ImportedData:
    """Print what an import would read from a file, and return it."""
    out = console.stdout()
    facts = "; ".join([count(len(table), "row"), *map(safe, table.notes)])
    out.print(f"[bold]{display_path(table.path)}[/bold]: {facts}")
    try:
        imported = import_table(table, options)
    except InputError:
        out.print(_columns(table))
        raise
    if imported.roles != like:
        out.print(_columns(table, imported.roles))
    for channel in imported.channels:
        unit, effort = channel.position_unit, channel.effort_unit
        numbers = ("samples", "time", safe(f"position [{unit}]"), safe(f"effort [{effort}]"))
        rate = 1.0 / sample_time(channel.time_s, channel.run)
        title = f"{safe(imported.title(channel.name))}: {count(len(channel.runs), 'run')} at {rate:.4g} Hz"
        out.print(f"[bold]{title}[/bold]")
        made = console.table("", "run", *numbers, right=numbers)
        for run in channel.runs[:_MOST_RUNS]:
            part = channel.select(channel.run == run)
            label = safe(imported.run_labels.get(int(run), str(run)))
            ends = ((values.min(), values.max()) for values in (part.position, part.effort))
            ranges = (f"{rounded(low, 2)} to {rounded(high, 2)}" for low, high in ends)
            made.add_row(label, str(len(part)), duration(float(np.ptp(part.time_s))), *ranges)
        if (more := len(channel.runs) - _MOST_RUNS) > 0:
            made.add_row(f"{more} more")
        out.print(made)
        # total over all runs in order of first appearance, without pauses
        usual_s, steps_s = 1.0 / rate, np.diff(channel.time_s, append=channel.time_s[-1:])
        is_pause = (steps_s < 0.0) | (steps_s > _PAUSE * usual_s) | (np.diff(channel.run, append=-1) != 0)
        steps_s[is_pause] = usual_s
        codes = [number for number in dict.fromkeys(channel.phase.tolist()) if number in set(Phase)]
        spans = (f"{phase(n)[0]} {duration(float(np.sum(steps_s[channel.phase == n])))}" for n in codes)
        if phases := ", ".join(spans):
            out.print(f"phases: {phases}")
    for note in imported.notes:
        out.print(f"[yellow]{safe(note)}[/yellow]")
    return imported


def _plausibility_warnings(imported: ImportedData) -> list[str]:
    """Describe implausible properties of the data of each channel, one sentence each."""
    return list_warnings(
        (imported.title(c.name), [*quality_warnings(c), *filter(None, [unchanging(c)])])
        for c in imported.channels
    )


def _columns(table: Table, roles: Mapping[str, str] | None = None) -> Printed:
    """Tabulate the columns, with their roles where known."""
    holds = () if roles is None else ("holds",)
    made = console.table("", "column", *holds, "first values")
    for name in table.names[:_MOST_COLUMNS]:
        values = table.head(_VALUES).columns.column(name).to_pylist()
        for digits in (4, 8, 12):  # fewest digits that show that the values differ
            texts = [f"{value:.{digits}g}" if isinstance(value, float) else str(value) for value in values]
            if len(set(texts)) == len(set(map(str, values))):
                break
        role = () if roles is None else (safe(roles.get(name, "")) or "[dim]not used[/dim]",)
        made.add_row(safe(name), *role, safe(", ".join(texts)[:40]))
    return made
