"""`palpate batch`: many recordings at once, one table and one page."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from palpate.common import console, options
from palpate.common.console import count, display_path, format_computed_p_value, plus_minus, safe, significant
from palpate.robot_io.errors import InputError
from palpate.workflows.data_options import StudyOptions

if TYPE_CHECKING:
    import pyarrow as pa

    from palpate.batches.pooling import BatchResult, PooledParameter

_MOST_SHOWN = 8  # errors, outliers and parameters in the terminal; the page has all


_DATA = "Folder, files, a file pattern in quotes, or a CSV table with a column 'file' and further fields."


@dataclass(frozen=True, kw_only=True)
class BatchArguments(StudyOptions):
    """Measurements of a batch, and the options that belong to all of them, as the user typed them."""

    data: Annotated[list[str], Argument(help=_DATA, metavar="FOLDER|FILES|LIST.csv")]


_MODEL = (
    "Base model, or 'suggest' to choose the model that fits a few measurements best; default: the usual "
    "model of each channel."
)
_POOL = "Combine the evidence of all measurements, to detect effects that are too small for a single one."
_METADATA = (
    "CSV file with further fields. A row belongs to the file that its column 'file' names, or to the files "
    "with the same values in shared fields."
)
_JOIN = "Treat files with the same text in this field as one measurement."
_SPLIT = "Treat rows with the same text in this column as one measurement."
_SHARE = "Effect whose parameters are assumed equal in all channels of a group; may be repeated."
_OUT = "Output folder; if it contains an interrupted batch, this batch continues."
_DIAGNOSE = "Also find out which effects are missing (takes longer)."
_GROUP = "Compare groups of measurements by this field."
_REPORTS = "Number of outliers to write reports for; the page links to the reports."


@options.with_options(BatchArguments, "data")
def batch_command(
    data: BatchArguments,
    *,
    out: Annotated[Path, Option("--out", "-o", help=_OUT)],
    model: Annotated[str | None, Option(help=_MODEL, autocompletion=options.model_names)] = None,
    diagnose: Annotated[bool, Option("--diagnose", help=_DIAGNOSE)] = False,
    pool: Annotated[bool, Option("--pool", help=_POOL)] = False,
    add: options.AddOption = None,
    pattern: options.PatternOption = None,
    metadata: Annotated[Path | None, Option(help=_METADATA, metavar="FILE")] = None,
    join: Annotated[str | None, Option(help=_JOIN, metavar="FIELD")] = None,
    split: Annotated[str | None, Option(help=_SPLIT, metavar="COLUMN")] = None,
    group: Annotated[str | None, Option(help=_GROUP, metavar="FIELD")] = None,
    share: Annotated[
        list[str] | None, Option(help=_SHARE, metavar="EFFECT", autocompletion=options.effect_names)
    ] = None,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    retry: Annotated[bool, Option("--retry", help="Retry measurements that could not be evaluated.")] = False,
    reports: Annotated[int, Option(help=_REPORTS, min=0)] = 3,
    as_json: options.JsonOption = False,
) -> None:
    """Estimate and compare many measurements, and write a table and a web page.

    Each file is a measurement; --join combines several files into one, --split divides a file into
    several. With --diagnose, finds missing effects too. A file that cannot be read becomes a row with the
    reason; exit code 2 if no file can be read. To continue after an interruption, run the same command again.

    Examples:
      palpate batch recordings --out result
      palpate batch 'data/*.csv' --pattern '{specimen}_{day}.csv' --group day --diagnose --out result
      palpate batch spots.csv --split run --out result
    """
    from palpate.batches.run import batch  # noqa: PLC0415, its libraries take a second
    from palpate.render.progress import sweep_progress  # noqa: PLC0415, as above

    counted = [0, 0]
    try:
        with sweep_progress() as progress:

            def count_done(done: int, total: int) -> None:
                counted[:] = done, total
                progress(done, total)

            result = batch(
                data.data,
                out=out,
                model=model,
                diagnose=diagnose,
                pool=pool,
                add=add or (),
                pattern=pattern,
                metadata=metadata,
                join=join,
                split=split,
                group=group,
                share=share or (),
                read=data.options,
                urdf=data.urdf,
                tip_frame=data.tip_frame,
                effects=data.effect or (),
                workers=workers,
                scheduler=scheduler,
                retry=retry,
                reports=reports,
                progress=count_done,
            )
    except (KeyboardInterrupt, SystemExit):
        if counted[1]:
            console.stderr().print(
                f"{counted[0]} of {counted[1]} measurements are done and saved in {display_path(out)}; "
                "run the same command again to continue"
            )
        raise
    if len(result.errors) == result.measurements:
        name, reason = next(iter(result.errors.items()))
        reason = reason if name in reason else f"{name}: {reason}"
        if result.measurements > 1:
            reason = f"none of {result.measurements} measurements is readable; {reason}"
        raise InputError(f"{reason} (all reasons: {result.folder / 'table.csv'}; page: {result.page})")

    console.present(result.as_data(), lambda: _print(result, pool=pool), as_json=as_json)


def _print(result: "BatchResult", *, pool: bool) -> None:
    """Print counts, effects, cautions, pooled parameters, errors and the page's address."""
    from palpate.batches.table import texts  # noqa: PLC0415, its libraries take a second

    to, table = console.stdout(), result.table
    models = dict.fromkeys(filter(None, texts(table, "model")))
    with_models = f" with model {safe(', '.join(models))}" if models else ""
    many = count(result.measurements, "measurement")
    to.print(f"[bold]{many}[/bold]{with_models}, {len(result.errors)} unreadable")
    for verdict, number in Counter(filter(None, texts(table, "verdict"))).most_common():
        console.say_below(f"{verdict}: {number}")
    if effects := Counter(name for text in texts(table, "effects") for name in text.split(", ") if name):
        named = ", ".join(f"{name} {number}" for name, number in effects.most_common(_MOST_SHOWN))
        console.say_below(f"effects named: {named}")
    for words in _warnings(table):
        console.say_below(f"[yellow]{safe(words)}[/yellow]")
    missing = [
        f"{each.channel}: {each.effect}"
        + f" (or {', '.join(each.confused_with)})" * bool(each.confused_with)
        + f" is missing in the pooled data and explains {100 * each.share:.2g} % of the squared error"
        for each in result.common_effects
    ]
    for words in missing or ["--pool: the pooled data show no missing effect"] * pool:
        console.say_below(f"[bold]{safe(words)}[/bold]")
    for entry in result.pooled[:_MOST_SHOWN]:
        console.say_below(f"{safe(_mean(entry))}")
    for shared in result.shared:
        group = "" if shared.group == "all" else f"{shared.group} "
        where = safe(f"{group}{shared.parameter} in {count(shared.count, 'estimate')}")
        if shared.contradicted:
            problem = f"{where} is not shared: the estimates differ by more than their intervals allow"
            console.say_below(
                f"[yellow]{problem}[/yellow] (corrected p {format_computed_p_value(shared.p_corrected)})"
            )
        else:
            value = plus_minus(shared.value, shared.interval[1] - shared.value)
            console.say_below(f"{where}, shared: {safe(f'{value} {shared.unit} (95 %)')}")
    for difference in result.differences:
        if difference.p_corrected < 0.05:
            words = f"{difference.parameter} differs between {' and '.join(difference.groups)}"
            corrected = format_computed_p_value(difference.p_corrected)
            console.say_below(f"[yellow]{safe(words)}[/yellow] (corrected p {corrected})")
    for name, error in list(result.errors.items())[:_MOST_SHOWN]:
        console.say_below(f"[yellow]{safe(error if name in error else f'{name}: {error}')}[/yellow]")
    if result.outliers:
        console.say_below(f"{count(len(result.outliers), 'outlier')}: see the page")
    to.print(f"page  [bold]{display_path(result.page)}[/bold]")


def _warnings(table: "pa.Table") -> Iterator[str]:
    """Warn of copies of a measurement, and of a model that does not fit where no diagnosis says so."""
    from palpate.batches.table import floats, texts  # noqa: PLC0415, its libraries take a second

    same: dict[str, set[str]] = {}
    for address, name in zip(texts(table, "address"), texts(table, "measurement"), strict=True):
        same.setdefault(address, set()).add(name)
    if copies := [sorted(each) for address, each in same.items() if address and len(each) > 1]:
        number = sum(map(len, copies)) - len(copies)
        has = "has" if number == 1 else "have"
        yield (
            f"{count(number, 'measurement')} {has} the same content as another ({', '.join(copies[0][:2])}); "
            "means and tests count each copy"
        )
    names = (texts(table, name) for name in ("channel", "model", "verdict", "fits"))
    judged: dict[tuple[str, str], list[tuple[bool, float]]] = {}
    for channel, model, verdict, fits, times in zip(*names, floats(table, "times_noise"), strict=True):
        if channel and not verdict and fits:
            judged.setdefault((channel, model), []).append((fits == str(True), times))
    for (channel, model), every in judged.items():
        missed = [times for fits, times in every if not fits]
        if missed:
            largest = max(missed)
            reach = f"errors reach {largest:.3g} times the noise, and " if isfinite(largest) else ""
            yield (
                f"{model} does not fit {channel} in {len(missed)} of {count(len(every), 'measurement')}: "
                f"{reach}the model's parameters may be biased; add --diagnose to find the missing effect"
            )


def _mean(entry: "PooledParameter") -> str:
    """Format a pooled mean with the half width of its 95 % interval, if any, and the spread."""
    effects = entry.effects
    group = "" if entry.group == "all" else entry.group
    name = f"{group} {entry.channel} {entry.parameter}".strip()
    if effects.count < 2:
        return f"{name}: {significant(effects.mean, effects.std_err)} {entry.unit}, of one measurement"
    half = effects.interval[1] - effects.mean
    differ = "no spread between measurements detected"
    if effects.spread:
        differ = f"spread between measurements {significant(effects.spread, half)} {entry.unit}"
    return f"{name}: mean {plus_minus(effects.mean, half)} {entry.unit} (95 %), {differ}"
