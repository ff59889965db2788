"""Estimate, compare and diagnose many recordings, and write one table and one page."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from palpate.batches.common_effects import LEAST, CommonEffect, find_common_effects
from palpate.batches.measurements import (
    BatchMeasurement,
    MeasurementCase,
    case_of,
    content_hash,
    find_measurements,
)
from palpate.batches.page import write_page
from palpate.batches.pooling import (
    BatchResult,
    Outlier,
    PooledParameter,
    group_differences,
    outliers,
    pool,
    shared_parameters,
)
from palpate.batches.table import TABLE, field_names, head, make_table, parameter_columns, texts
from palpate.batches.tasks.measuring import write_measurement_report
from palpate.common.console import count, json_text
from palpate.common.files import existing_file, output_folder, write_text
from palpate.common.table_files import write_table
from palpate.common.user_effects import load_user_effects
from palpate.estimation.data.import_options import NO_OPTIONS, ImportOptions
from palpate.estimation.effects import EFFECTS
from palpate.estimation.models import MODELS
from palpate.robot_io.errors import InputError, PalpateError
from palpate.sweep import RESULTS, Cluster, ResultStore, refuse_other_files, run_cases
from palpate.sweep.case import ADDRESS
from palpate.sweep.runner import Progress

REPORTS, SUMMARY = "reports", "summary.json"
SUGGEST = "suggest"  # in place of a base model
MOST_REPORTS = 3
# Valid texts of arguments, for messages.
_EXAMPLES = {
    "model": "kelvin_voigt",
    "pattern": "{specimen}_{day}.csv",
    "join": "specimen",
    "split": "run",
    "group": "specimen",
}
_SAMPLE = 7  # measurements that suggest a base model


def batch(
    data: Path | str | Sequence[Path | str],
    *,
    out: Path | str,
    model: str | None = None,
    diagnose: bool = False,
    pool: bool = False,
    add: Sequence[str] = (),
    pattern: str | None = None,
    metadata: Path | str | None = None,
    join: str | None = None,
    split: str | None = None,
    group: str | None = None,
    share: Sequence[str] = (),
    read: ImportOptions = NO_OPTIONS,
    urdf: Path | str | None = None,
    tip_frame: str | None = None,
    effects: Sequence[str] = (),
    workers: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    reports: int = MOST_REPORTS,
    progress: Progress = lambda _done, _total: None,
) -> BatchResult:
    """Evaluate many measurements; results that the output folder already holds are reused.

    Args:
        data: file, folder, pattern such as "data/*.csv", CSV list with a column `file`, or several of these.
        out: output folder.
        model: base model; "suggest" for the one that fits a sample best; None for the usual one by channel.
        diagnose: also find out which effects are missing.
        pool: also combine the evidence of all measurements for effects too small for one of them.
        add: effects that are fitted to every measurement in addition to the base model.
        pattern: pattern of file names, with fields in braces, such as "{specimen}_{day}.csv".
        metadata: CSV file with further fields.
        join: field; files with the same text in it are one measurement.
        split: column of the data files; each text in it is a measurement.
        group: field by which measurements are compared.
        share: effects whose parameters are the same in all channels and measurements of a group.
        read: options for reading a data file.
        urdf: URDF of the arm, for models that need it.
        tip_frame: tip frame in this URDF.
        effects: your own effects, such as "my_effects.py:MyEffect".
        workers: processes on this machine; None for one per core.
        scheduler: address of a dask scheduler; None for this machine.
        retry: try measurements again that could not be evaluated.
        reports: largest number of outliers for which to write a report; the page links to it.
        progress: called with the numbers of finished and of all measurements.

    Raises:
        InputError: there is nothing to measure, or an argument is not valid.
        PalpateError: the scheduler was lost; the same call continues from there.
    """
    _check_types(
        {"model": model, "pattern": pattern, "join": join, "split": split, "group": group},
        {"out": out, "metadata": metadata, "urdf": urdf},
        {"reports": (reports, 0), "workers": (workers, 1)},
        data,
    )
    places = [data] if isinstance(data, str | Path) else list(data)
    _check_names(model, [*add, *share], effects)
    folder = Path(out)
    refuse_other_files(folder)
    measurements = find_measurements(places, pattern=pattern, metadata=metadata, join=join, split=split)
    field_names(measurements, group)
    if pool and len(measurements) < LEAST:
        raise InputError(
            f"--pool: {count(len(measurements), 'measurement')} given; at least {LEAST} are needed"
        )
    sources = [existing_file(Path(path), "URDF") for path in ([urdf] if urdf else [])]
    own = [(Path(file), name) for file, _, name in (text.rpartition(":") for text in effects)]
    sources += [file for file, _ in own]
    options = {
        "model": model,
        "diagnose": diagnose,
        "add": list(add),
        "read": read.stated(),
        "urdf": str(Path(urdf).absolute()) if urdf else None,
        "tip_frame": tip_frame,
        "effects": [f"{file.absolute()}:{name}" for file, name in own],
        "sources": [content_hash(path) for path in sources],
    }
    output_folder(folder)
    store, cluster = ResultStore(folder / RESULTS), Cluster(scheduler, workers)

    def ask(some: Sequence[BatchMeasurement], question: Mapping[str, Any], progress: Progress) -> pa.Table:
        """Run cases of some measurements with further options, and return their rows."""
        requested = _cases(some, {**options, **question}, {}).values()
        run_cases(list(requested), store, cluster, progress)
        return store.table(case.address for case in requested)

    if model == SUGGEST:  # the model that more than half of a sample suggest
        sampled = np.unique(np.linspace(0, len(measurements) - 1, _SAMPLE).round().astype(int))
        sample = [measurements[number] for number in sampled]
        rows = ask(sample, {"model": None, "suggest": True}, lambda done, total: None)
        models = Counter(texts(rows, "suggested"))
        best, votes = models.most_common(1)[0] if models else ("", 0)
        options["model"] = (best or None) if votes > models.total() / 2 else None
    failures: dict[str, str] = {}
    cases = _cases(measurements, options, failures)
    addresses = [cases[each.name].address if each.name in cases else None for each in measurements]
    if retry:
        results = store.table(filter(None, addresses))
        if "error" in results.column_names:
            store.drop(results.filter(pc.not_equal(results["error"], ""))[ADDRESS].to_pylist())

    common: tuple[CommonEffect, ...] = ()

    def result(share: Sequence[str] = ()) -> BatchResult:
        table = make_table(measurements, addresses, store.table(filter(None, addresses)), failures, group)
        finished = len(set(texts(table, "measurement")))
        progress(finished, len(measurements))  # the call before may have counted the cases of --pool
        where = {each.name: each.where for each in measurements if each.where}
        return _write(
            BatchResult(folder, table, len(measurements), finished, common_effects=common, where=where), share
        )

    try:
        failures |= _run(cases, store, cluster, progress)
        del cases  # they take as much memory as the table
        if pool:
            common = find_common_effects(lambda requested: ask(measurements, {"screen": requested}, progress))
    except (KeyboardInterrupt, SystemExit, PalpateError):
        if failures or store.finished().intersection(filter(None, addresses)):
            result()
        raise
    made = result(share)
    return _with_reports(made, measurements, options, reports) if reports else made


def _check_types(
    words: Mapping[str, object],
    paths: Mapping[str, object],
    counts: Mapping[str, tuple[int | None, int]],
    data: object,
) -> None:
    """Raise `InputError` if an argument from Python is no text or path, or a number is below its least."""
    for name, value in words.items():
        if not isinstance(value, str | None):
            raise InputError(f"{name}={value!r}: give a string, such as {name}={_EXAMPLES[name]!r}")
    for name, value in paths.items():
        if not isinstance(value, str | Path | None):
            raise InputError(f"{name}={value!r}: give a path")
    for name, (number, least) in counts.items():
        if number is not None and number < least:
            raise InputError(f"{name}={number}: give a whole number of at least {least}")
    if not isinstance(data, Iterable | Path):
        raise InputError(f"data={data!r}: give a path, or a list of paths")


def _check_names(model: str | None, names: Sequence[str], own: Sequence[str]) -> None:
    """Raise `InputError` if there is no such base model, or no such effect of the library or the user."""
    known = {effect.name for effect in load_user_effects(own).values()}
    for name in names:
        if name not in known:
            EFFECTS[name]  # which says what there is
    if model not in {None, SUGGEST}:
        MODELS[str(model)]


def _run(
    cases: Mapping[str, MeasurementCase], store: ResultStore, cluster: Cluster, progress: Progress
) -> dict[str, str]:
    """Run the cases without a result; return the reasons of those that fail, by measurement."""
    # The order of addresses is random with respect to file sizes, so the pace so far predicts the rest.
    order = sorted({case.address: case for case in cases.values()}.items())
    report = run_cases([case for _, case in order], store, cluster, progress)
    return {
        name: text.removeprefix(f"{case.label}: ")
        for text in report.failures
        for name, case in cases.items()
        if text.startswith(f"{case.label}: ")
    }


def _cases(
    measurements: Sequence[BatchMeasurement], options: Mapping[str, Any], failures: dict[str, str]
) -> dict[str, MeasurementCase]:
    """Return the cases by measurement; add the reasons why files cannot be read to `failures`."""
    cases = {}
    for measurement in measurements:
        try:
            cases[measurement.name] = case_of(measurement, options)
        except OSError as error:
            failures[measurement.name] = f"{error.filename}: {error.strerror}"
    return cases


def _write(batch: BatchResult, share: Sequence[str]) -> BatchResult:
    """Pool all parameters, and write table, page and summary; return the result with all of these."""
    table, groups = batch.table, texts(batch.table, "group")
    pooled: list[PooledParameter] = []
    outlying: list[Outlier] = []
    columns = list(parameter_columns(table))
    drawn: dict[str, np.ndarray[Any, Any]] = {}
    for column in columns:
        entries, values = pool(column, groups)
        pooled += entries
        outlying += outliers(column, groups)
        drawn.setdefault(column.head, np.full(len(table), np.nan))[column.rows] = values
    for column in columns:
        if column.head in drawn:
            after = table.column_names.index(head(column.name, column.unit, "std_err")) + 1
            cells = pa.array(drawn.pop(column.head), from_pandas=True)
            table = table.add_column(after, head(column.name, column.unit, "shrunk"), cells)
    for ending in (".parquet", ".csv"):
        write_table(table, batch.folder / f"{TABLE}{ending}")
    made = replace(
        batch,
        table=table,
        pooled=tuple(pooled),
        differences=tuple(group_differences(pooled)),
        outliers=tuple(outlying),
        shared=tuple(shared_parameters(columns, groups, share)),
    )
    _write_views(made)
    return made


def _write_views(made: BatchResult) -> None:
    """Write summary and page."""
    write_text(made.folder / SUMMARY, json_text(made.as_data()))
    write_page(made)


def _with_reports(
    made: BatchResult, measurements: Sequence[BatchMeasurement], options: Mapping[str, Any], most: int
) -> BatchResult:
    """Write reports of the measurements that are farthest from their group, and link them in the page."""
    names = texts(made.table, "measurement")
    far = sorted(made.outliers, key=lambda entry: -abs(entry.z))
    chosen = list(dict.fromkeys(names[entry.row] for entry in far))[:most]
    by_name = {each.name: each for each in measurements if each.name in chosen}
    reports = {}
    for name in chosen:
        with suppress(OSError, PalpateError):  # the page then shows the command, which gives the reason
            case = case_of(by_name[name], options)
            stem = re.sub(r"[^\w.-]+", "_", name)
            file = f"{REPORTS}/{stem}-{case.address[:8]}.html"
            if not (made.folder / file).is_file():
                output_folder(made.folder / REPORTS)
                files = [Path(text) for text in by_name[name].files]
                write_measurement_report(files, case.parameters, made.folder / file)
            reports[name] = file
    if reports:
        made = replace(made, reports=reports)
        _write_views(made)
    return made
