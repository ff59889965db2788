"""`palpate trend`: find steps and drifts of parameters over time."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from palpate.common import console
from palpate.common.console import count, display_path, safe, significant
from palpate.common.options import AddOption, JsonOption, PatternOption, model_names
from palpate.robot_io.errors import InputError

if TYPE_CHECKING:
    from palpate.batches.trend import Series

PAGE = "trend.html"
CHANGED = 10  # exit code, the same as of a diagnosis with missing effects


_DATE = (
    "Field with dates (ISO 8601) or numbers; default: date, day, night, time, datetime or "
    "timestamp, otherwise the order of the rows."
)
_PARAMETER = "Only this parameter, such as coulomb_friction.force; may be repeated."
_OUT = "First process the recordings, and write the results to this folder."
_GROUP = "Test groups of measurements separately; a group has the same value in this field."
_DATA = "Folder or table written by palpate batch; with --out, a folder of recordings."
_MODEL = "Base model to fit to the recordings."
_FOLLOW = "Keep running, and test again whenever there are new data."
_EXIT_CODE = f"Exit code {CHANGED} if something changes, else 0."


def trend_command(
    data: Annotated[Path, Argument(help=_DATA)],
    *,
    date: Annotated[str | None, Option(help=_DATE, metavar="FIELD")] = None,
    parameter: Annotated[list[str] | None, Option(help=_PARAMETER, metavar="NAME")] = None,
    out: Annotated[Path | None, Option("--out", "-o", help=_OUT)] = None,
    model: Annotated[str | None, Option(help=_MODEL, autocompletion=model_names)] = None,
    pattern: PatternOption = None,
    group: Annotated[str | None, Option(help=_GROUP, metavar="FIELD")] = None,
    add: AddOption = None,
    follow: Annotated[bool, Option("--follow", help=_FOLLOW)] = False,
    every_s: Annotated[float, Option(help="Time between tests of --follow.", metavar="S", min=0.1)] = 30.0,
    exit_code: Annotated[bool, Option("--exit-code", help=_EXIT_CODE)] = False,
    as_json: JsonOption = False,
) -> None:
    """Find parameters that step or drift by more than their scatter, and report when and by how much.

    In each group, tests every parameter, the ratio of error to noise, and the share of each kind of effect
    in the error. If nothing changes, the probability of a false alarm in a whole table is 1 %.
    Writes trend.html beside the table.

    Examples:
      palpate batch logs --pattern '{arm}_{date}.csv' --group arm --out nightly
      palpate trend nightly --exit-code
      palpate trend logs --out nightly --pattern '{date}.csv' --add coulomb_friction --follow
    """
    options = {"model": model, "pattern": pattern, "group": group, "add": add or []}
    if out is None and (given := [name for name, value in options.items() if value]):
        raise InputError(f"--{given[0]}: applies only if recordings are processed; add --out FOLDER")
    seen: object = None
    while True:
        # names, sizes and times of the watched files, without the page that trend writes
        files = sorted(data.iterdir()) if data.is_dir() else [data] if data.exists() else []
        known = [(file.name, file.stat()) for file in files if file.is_file() and file.name != PAGE]
        state = [(name, stat.st_size, stat.st_mtime_ns) for name, stat in known]
        if state != seen:
            seen = state
            changed = _update(data, date, parameter or [], out, options, as_json)
        if not follow:
            break
        time.sleep(every_s)
    if exit_code and changed:
        raise typer.Exit(CHANGED)


def _update(  # noqa: PLR0917, what was typed
    data: Path, date: str | None, names: list[str], out: Path | None, options: dict[str, Any], as_json: bool
) -> bool:
    """Test all series once, print and write the changes; return whether there is any."""
    from palpate.batches.page import write_trend  # noqa: PLC0415, its libraries take a second
    from palpate.batches.piecewise import LEAST  # noqa: PLC0415, as above
    from palpate.batches.table import TABLE, read_table  # noqa: PLC0415, as above
    from palpate.batches.trend import (  # noqa: PLC0415, as above
        DATES,
        LEVEL,
        all_series,
        find_changes,
        least_for_step,
        time_axis,
    )

    if out is not None:
        from palpate.batches.run import batch  # noqa: PLC0415, as above
        from palpate.render.progress import sweep_progress  # noqa: PLC0415, as above

        with sweep_progress() as progress:
            table = batch(data, out=out, **options, reports=0, progress=progress).table
    elif data.is_dir() and not (data / f"{TABLE}.parquet").is_file():
        raise InputError(
            f"{data}: contains no table from palpate batch; to analyze recordings in it, add --out FOLDER"
        )
    else:
        table = read_table(data)
    times, labels, what = time_axis(table, date)
    if what == "count" and (unread := [name for name in table.column_names if name.lower() in DATES]):
        console.warn(f"column {unread[0]} has no dates such as 2026-11-23, so the order of rows is used")
    known = list(all_series(table, times))
    available = list(dict.fromkeys(series.name for series in known))
    if unknown := set(names) - set(available):
        raise InputError(
            f"--parameter {min(unknown)}: no such series, or it has fewer than {LEAST} measurements. "
            f"Available: {', '.join(available) or 'none'}"
        )
    chosen = [series for series in known if not names or series.name in names]
    varying = [series for series in chosen if not series.is_constant]
    # one level for the table as a whole
    tested = [(series, find_changes(series, LEVEL / len(varying))) for series in varying]
    least = least_for_step(len(tested))
    page = (out or (data if data.is_dir() else data.parent)) / PAGE
    write_trend(page, tested, what)

    def labeled(series: "Series") -> dict[str, Any]:
        return {"group": series.group, "channel": series.channel, "series": series.name}

    content: dict[str, Any] = {
        "table": str(out or data),
        "time": what,
        "measurements": len(set(table["measurement"].to_pylist())),
        "tested": len(tested),
        "constant": [_series_name(labeled(series)) for series in chosen if series.is_constant],
        "level": LEVEL,
        "least_for_step": least,
        "short": sum(len(series.values) < least for series, _ in tested),
        "changes": [
            labeled(series)
            | {"unit": series.unit}
            | vars(change)
            | {end: labels[series.rows[getattr(change, end)]] for end in ("first", "last")}
            for series, own in tested
            for change in own
        ],
        "left_out": [
            labeled(series) | {"at": labels[row], "value": value}
            for series, _ in tested
            for row, value in series.left_out
        ],
    }

    def show() -> None:
        to, short, constant = console.stdout(), content["short"], content["constant"]
        to.print(f"{count(len(set(labels)), 'time')}, {len(tested)} series tested")
        for change in content["changes"]:
            console.say_below(f"[yellow]{safe(describe_change(change))}[/yellow]")
        if constant and (names or not tested):
            console.say_below(
                f"not tested, because all measurements have the same value: {safe(', '.join(constant))}"
            )
        elif not tested:
            console.say_below(f"nothing is tested: a series needs at least {LEAST} measurements")
        if not content["changes"] and short < len(tested):
            console.say_below("nothing changes by more than its scatter")
        if short:
            console.say_below(
                f"[yellow]too short to detect a step: {short} of {len(tested)} series. With {len(tested)} "
                f"series, each needs {least} measurements; to test fewer series, add --parameter[/yellow]"
            )
        if left_out := content["left_out"]:
            which = f"{_series_name(left_out[0])} at {left_out[0]['at']} ({left_out[0]['value']:.3g})"
            others = " and others" if len(left_out) > 1 else ""
            words = f"{count(len(left_out), 'isolated value')} left out: {safe(which)}{others}"
            console.say_below(f"[dim]{words}[/dim]")
        to.print(f"page  [bold]{display_path(page)}[/bold]")

    console.present(content, show, as_json=as_json)
    return bool(content["changes"])


def _series_name(entry: Mapping[str, Any]) -> str:
    return " ".join(filter(None, (entry["group"], entry["channel"], entry["series"])))


def describe_change(change: dict[str, Any]) -> str:
    """Describe a change in a sentence.

    Args:
        change: the change, as plain data.
    """
    from palpate.estimation.fit.intervals import SIGMAS_95  # noqa: PLC0415, its libraries take a second

    before, after = (significant(change[name], change["std_err"]) for name in ("before", "after"))
    share = ""
    if abs(change["before"]) > SIGMAS_95 * change["std_err"]:  # else a percentage would be noise
        share = f" ({100 * (change['after'] / change['before'] - 1):+.0f} %)"
    when = (
        f"at {change['first']}" if change["kind"] == "step" else f"from {change['first']} to {change['last']}"
    )
    verb = "steps" if change["kind"] == "step" else "drifts"
    return f"{_series_name(change)} {verb} from {before} to {after} {change['unit']}{share} {when}"
