"""`palpate info`: what is in a session file?"""

from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from estimation.data.session_streams import RUN_LABELS
from palpate.common import console
from palpate.common.files import open_session
from palpate.common.formatting import count, duration, safe, shown
from palpate.runs.session import NOT_WHOLE
from robot_io.calibration import parse_calibrations
from robot_io.session import Session

MOST_EVENTS = 40  # shown; --json prints all


def command(
    session: Annotated[Path, typer.Argument(help="Session file (.mcap).")],
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Show what a session holds: when and how it was made, streams, events, and whether it is whole."""
    found = open_session(session)
    data = describe(found)
    if as_json:
        console.print_json(data)
    else:
        _print(found, data)


def describe(session: Session) -> dict[str, Any]:
    """The session's facts as plain data; the keys are stable."""
    metadata = session.metadata
    streams = [_describe_stream(session, name) for name in session.stream_names]
    return {
        "file": str(session.path),
        "created_utc": metadata.created_utc,
        "software_version": metadata.software_version,
        "command_line": metadata.command_line,
        "seed": metadata.seed,
        "calibrations": list(parse_calibrations(metadata.calibration).kinds) if metadata.calibration else [],
        "simulated": bool(metadata.scenario),
        "extra": dict(metadata.extra),
        "duration_s": max((stream["duration_s"] for stream in streams), default=0.0),
        "truncated": session.truncated,
        "unclosed": session.unclosed,
        "dropped": session.dropped,
        "streams": streams,
        "events": [vars(event) for event in session.events],
    }


def _describe_stream(session: Session, name: str) -> dict[str, Any]:
    samples = session.samples(name)
    time_s = samples["time_s"]
    steps = np.diff(time_s)
    step_s = float(np.median(steps)) if len(steps) else 0.0
    runs = np.unique(samples["run"]) if "run" in samples else np.empty(0)
    return {
        "name": name,
        "samples": len(samples),
        "duration_s": float(steps[steps > 0.0].sum()),  # a clock may begin anew with a run or session
        "rate_hz": 1.0 / step_s if step_s > 0 else None,
        "runs": int(np.count_nonzero(runs >= 0)),
        "columns": [
            {"name": c.name, "unit": c.unit, "width": c.width, "doc": c.doc} for c in samples.stream.columns
        ],
    }


def _print(session: Session, data: dict[str, Any]) -> None:
    out = console.stdout()
    out.print(f"[bold]{shown(session.path)}[/bold]")
    for label, value in _facts(data).items():
        out.print(f"  {label:<10} {value}")
    numbers = ("samples", "rate", "runs")
    table = console.table("Streams", "stream", *numbers, "columns", right=numbers)
    for stream in data["streams"]:
        rate = f"{stream['rate_hz']:.0f} Hz" if stream["rate_hz"] else "–"
        columns = ", ".join(
            f"{c['name']}[{c['width']}]" if c["width"] > 1 else c["name"] for c in stream["columns"]
        )
        runs = str(stream["runs"] or "–")
        table.add_row(safe(stream["name"]), str(stream["samples"]), rate, runs, f"[dim]{safe(columns)}[/dim]")
    out.print(table)
    if data["events"]:
        out.print(_event_table(session))


def _facts(data: dict[str, Any]) -> dict[str, str]:
    merged = data["extra"].get(NOT_WHOLE, "")
    lacks = data["truncated"] or data["dropped"] or data["unclosed"] or merged
    whole = "[yellow]no:[/yellow] " if lacks else "yes"
    if data["unclosed"]:
        whole += "the program ended without closing it (it was killed); what it logged until then is here; "
    if data["truncated"]:
        whole += "the end is missing (the program was killed, or is still writing); "
    if data["dropped"]:
        whole += f"{count(data['dropped'], 'record')} dropped because the disk was too slow; "
    if merged:
        whole += f"merged from sessions that were not whole: {safe(merged)}"
    version = data["software_version"] or "?"
    facts = {
        "made": safe(f"{data['created_utc'] or 'unknown'} by palpate {version}"),
        "with": safe(data["command_line"]) or "unknown",
        "source": safe(data["extra"].get("source", "simulated" if data["simulated"] else "measured")),
        "seed": "none" if data["seed"] is None else str(data["seed"]),
        "calibrated": ", ".join(data["calibrations"]) or "nothing",
        "duration": duration(data["duration_s"]),
        "whole": whole.rstrip("; "),
    }
    known = {*facts, RUN_LABELS, NOT_WHOLE}  # what runs were called is for programs, and in --json
    further = ((key, value) for key, value in data["extra"].items() if key not in known and len(value) < 100)
    return facts | {safe(key): safe(value) for key, value in further}


def _event_table(session: Session) -> Table:
    """Times count from the session's begin: a real arm's clock has run since its machine was started."""
    table = console.table("Events", "time", "kind", "what", right=("time",))
    times_s = (session.samples(name)["time_s"][:1].tolist() for name in session.stream_names)
    start_s = min(chain(*times_s, (event.time_s for event in session.events)))
    for event in session.events[:MOST_EVENTS]:
        table.add_row(f"{event.time_s - start_s:.3f} s", safe(event.kind), safe(event.text))
    if len(session.events) > MOST_EVENTS:
        table.add_row("", "", f"... and {len(session.events) - MOST_EVENTS} more (see --json)")
    return table
