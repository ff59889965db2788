"""`palpate info`: describe a session with as few imports as possible."""

from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Argument

from palpate.common import console
from palpate.common.console import count, display_path, duration, safe
from palpate.common.files import open_session
from palpate.common.options import JsonOption
from palpate.robot_io.session import Session
from palpate.robot_io.session.event import NOT_WHOLE, RUN_LABELS

MOST_EVENTS = 40  # shown; --json prints all


def info_command(
    session: Annotated[Path, Argument(help="Session file (.mcap).")], as_json: JsonOption = False
) -> None:
    """Show the content of a session: time, origin, streams, events, and whether it is complete."""
    opened = open_session(session)
    data = _describe_session(opened)
    if as_json:
        console.print_json(data)
        return
    out = console.stdout()
    out.print(f"[bold]{display_path(opened.path)}[/bold]")
    merged = data["extra"].get(NOT_WHOLE, "")
    killed = "the program was killed before it closed the file; the file holds everything logged until then"
    lacking = [
        reason
        for applies, reason in (
            (data["unclosed"], killed),
            (data["truncated"], "the end is missing (the program was killed, or is still writing)"),
            (data["dropped"], f"{count(data['dropped'], 'record')} dropped because the disk was too slow"),
            (merged, f"merged from incomplete sessions: {safe(merged)}"),
        )
        if applies
    ]
    facts = {
        "made": safe(f"{data['created_utc'] or 'unknown'} by palpate {data['software_version'] or '?'}"),
        "with": safe(data["command_line"]) or "unknown",
        "source": safe(data["extra"].get("source", "simulated" if data["simulated"] else "measured")),
        "seed": "none" if data["seed"] is None else str(data["seed"]),
        "calibrated": ", ".join(data["calibrations"]) or "nothing",
        "duration": duration(data["duration_s"]),
        "complete": f"[yellow]no:[/yellow] {'; '.join(lacking)}" if lacking else "yes",
    }
    known = {*facts, RUN_LABELS, NOT_WHOLE}  # labels of runs are in --json only
    further = ((key, value) for key, value in data["extra"].items() if key not in known and len(value) < 100)
    for label, value in (*facts.items(), *((safe(key), safe(value)) for key, value in further)):
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
        table = console.table("Events", "time", "kind", "what", right=("time",))
        times_s = (opened.samples(name)["time_s"][:1].tolist() for name in opened.stream_names)
        # times are relative to the session's start: a real arm's clock runs since its machine was started
        start_s = min(chain(*times_s, (event.time_s for event in opened.events)))
        for event in opened.events[:MOST_EVENTS]:
            table.add_row(f"{event.time_s - start_s:.3f} s", safe(event.kind), safe(event.text))
        if len(opened.events) > MOST_EVENTS:
            table.add_row("", "", f"... and {len(opened.events) - MOST_EVENTS} more (see --json)")
        out.print(table)


def _describe_session(session: Session) -> dict[str, Any]:
    """Return the session's facts as plain data; the keys are stable."""
    metadata, calibrations = session.metadata, list[str]()
    if metadata.calibration:
        from palpate.robot_io.calibration.applied import parse_calibrations  # noqa: PLC0415, takes as long as all else

        calibrations += parse_calibrations(metadata.calibration).kinds
    streams: list[dict[str, Any]] = []
    for name in session.stream_names:
        samples = session.samples(name)
        steps = np.diff(samples["time_s"])
        step_s = float(np.median(steps)) if len(steps) else 0.0
        runs = np.unique(samples["run"]) if "run" in samples else np.empty(0)
        columns = samples.stream.columns
        streams.append(
            {
                "name": name,
                "samples": len(samples),
                "duration_s": float(steps[steps > 0.0].sum()),  # a clock may restart with a run or session
                "rate_hz": 1.0 / step_s if step_s > 0 else None,
                "runs": int(np.count_nonzero(runs >= 0)),
                "columns": [
                    {"name": c.name, "unit": c.unit, "width": c.width, "doc": c.doc} for c in columns
                ],
            }
        )
    return {
        "file": str(session.path),
        **{
            key: getattr(metadata, key) for key in ("created_utc", "software_version", "command_line", "seed")
        },
        "calibrations": calibrations,
        "simulated": bool(metadata.scenario),
        "extra": dict(metadata.extra),
        "duration_s": max((stream["duration_s"] for stream in streams), default=0.0),
        **{name: getattr(session, name) for name in ("truncated", "unclosed", "dropped")},
        "streams": streams,
        "events": [vars(event) for event in session.events],
    }
