"""A look at a data file before anything is stored: how it is written, what is taken for what, the runs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table as Printed

from control.loop.task import Phase
from estimation.channel import ChannelData
from estimation.data.import_file import Imported, import_table
from estimation.data.import_options import ImportOptions
from estimation.data.table import Table, read_table
from estimation.data_quality import quality_warnings
from estimation.signals.runwise import sample_time
from palpate.common import console
from palpate.common.formatting import count, duration, safe, shown
from palpate.render.palette import phase
from robot_io.errors import InputError

_VALUES = 3  # of a column that are shown
_MOST_COLUMNS = 60
_MOST_RUNS = 30


def look_as_data(path: Path, options: ImportOptions) -> dict[str, Any]:
    """What is in a file, as it would be imported, as plain data. InputError: it cannot be read."""
    table = read_table(path)
    imported = import_table(table, options)
    roles = dict(imported.roles)
    return {
        "file": str(path),
        "rows": len(table),
        "written": table.words,
        "columns": {name: roles.get(name) for name in table.names},
        "channels": facts(imported),
        "notes": [*imported.notes, *implausible(imported)],
    }


def facts(imported: Imported) -> list[dict[str, Any]]:
    """Kind, samples, runs and length of each channel, as plain data."""
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


def look_at(path: Path, options: ImportOptions, like: Mapping[str, str] | None = None) -> Mapping[str, str]:
    """Print what is in a file, as it would be imported; returns what its columns hold.

    Args:
        path: the file.
        options: how to read it.
        like: what the columns of the file before held: where they are the same they are not shown again.

    Raises:
        InputError: it cannot be read; its columns are shown before where they could be.
    """
    table, out = read_table(path), console.stdout()
    ways = "; ".join(table.words)
    out.print(f"[bold]{shown(path)}[/bold]: {count(len(table), 'row')}{'; ' + safe(ways) if ways else ''}")
    try:
        imported = import_table(table, options)
    except InputError:
        out.print(_columns(table))
        raise
    if imported.roles != like:
        out.print(_columns(table, dict(imported.roles)))
    for channel in imported.channels:
        unit, effort = channel.kind.position_unit, channel.kind.effort_unit
        numbers = ("samples", "time", f"position {unit}", f"effort {effort}")
        rate = 1.0 / sample_time(channel.time_s, channel.run)
        title = f"{channel.name}: {count(len(channel.runs), 'run')} at {rate:.4g} Hz"
        made = console.table(title, "run", *numbers, right=numbers)
        for run in channel.runs[:_MOST_RUNS]:
            one = channel.select(channel.run == run)
            made.add_row(
                safe(imported.run_labels.get(int(run), str(run))),
                str(len(one)),
                duration(float(np.ptp(one.time_s))),
                f"{one.position.min():.2g} to {one.position.max():.2g}",
                f"{one.effort.min():.2g} to {one.effort.max():.2g}",
            )
        out.print(made)
        if phases := _phases(channel):
            out.print(f"phases: {phases}")
    for note in (*imported.notes, *implausible(imported)):
        out.print(f"[yellow]{safe(note)}[/yellow]")
    return imported.roles


def implausible(imported: Imported) -> list[str]:
    """What in the channels is implausible, in one sentence each."""
    return [
        f"{channel.name}: {warning}" for channel in imported.channels for warning in quality_warnings(channel)
    ]


def _columns(table: Table, roles: dict[str, str] | None = None) -> Printed:
    """The columns, with what each holds where that is known."""
    holds = () if roles is None else ("holds",)
    made = console.table("", "column", *holds, "first values")
    for name in table.names[:_MOST_COLUMNS]:
        values = ", ".join(_told_apart(table.head(_VALUES).columns.column(name).to_pylist()))
        role = () if roles is None else (safe(roles.get(name, "")) or "[dim]not used[/dim]",)
        made.add_row(safe(name), *role, safe(values[:40]))
    return made


def _phases(channel: ChannelData) -> str:
    """How long each phase took in all runs together, in the order in which they came first."""
    step_s = sample_time(channel.time_s, channel.run)
    there = [number for number in dict.fromkeys(channel.phase.tolist()) if number in set(Phase)]
    return ", ".join(f"{phase(n)[0]} {duration(step_s * np.sum(channel.phase == n))}" for n in there)


def _told_apart(values: list[Any]) -> list[str]:
    """Values with as few digits as show that they differ, if they do."""
    for digits in (4, 8, 12):
        texts = [f"{value:.{digits}g}" if isinstance(value, float) else str(value) for value in values]
        if len(set(texts)) == len(set(map(str, values))):
            break
    return texts
