"""`palpate export` and `report`: write models, recorded data or a report."""

import math
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.common import console
from palpate.common.console import count, safe, shown, typed
from palpate.common.files import (
    derived_folder,
    existing_data,
    folder_to_read,
    open_session,
    output_file,
    write_text,
)
from palpate.estimation.channel import ChannelKind
from palpate.estimation.study.revisions import Revision, own_effects
from palpate.export.table import LAYOUT_ENDINGS, Program, check_ending, layout_of, recorded_table, write_table
from palpate.render.build import REPORT, is_own_page
from palpate.render.terminal import print_files
from palpate.render.view import NOISE
from palpate.robot_io.errors import InputError
from palpate.workflows.data_options import DataArguments, FolderOption, JsonOption, ModelOption, takes_data

if TYPE_CHECKING:
    from palpate.study import Study

SCENARIO, FEEDFORWARD = "scenario.yaml", "feedforward.yaml"
PROGRAMS = {Program.FOXGLOVE: "Foxglove", Program.PLOTJUGGLER: "PlotJuggler"}


class Format(StrEnum):
    """File format of the exported models."""

    SCENARIO = "scenario"
    FEEDFORWARD = "feedforward"
    MJCF = "mjcf"
    URDF = "urdf"
    ISAACLAB = "isaaclab"
    BAM = "bam"


# Name of the file that is written by default.
_FILES = {
    Format.SCENARIO: SCENARIO,
    Format.FEEDFORWARD: FEEDFORWARD,
    Format.MJCF: "model.xml",
    Format.URDF: "arm.urdf",
    Format.ISAACLAB: "actuators.py",
    Format.BAM: "bam.json",
}


@takes_data
def export_command(
    data: DataArguments,
    *,
    revision: Annotated[
        list[int] | None,
        typer.Option(help="Export these revisions; default: the newest of each channel.", metavar="N"),
    ] = None,
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            help="A simulated world; joint torques as a table and as functions in Python and C; or joints "
            "for MuJoCo, a URDF, Isaac Lab or BAM.",
        ),
    ] = Format.SCENARIO,
    patch: Annotated[
        Path | None,
        typer.Option(
            help=(
                "MJCF, URDF (default: --urdf) or BAM parameter file to copy and complete; the original "
                "stays as it is."
            ),
            metavar="FILE",
        ),
    ] = None,
    stream: Annotated[
        str | None,
        typer.Option(
            help="Write this stream or channel as a table instead, such as tick, events or contact."
        ),
    ] = None,
    layout: Annotated[
        Program | None,
        typer.Option(help="Write a layout file for viewing the session in this program."),
    ] = None,
    folder: FolderOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Scenario or feedforward (.yaml), simulator's file, or table (.csv, .parquet) to write.",
            metavar="FILE",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that already exists.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write the fitted models of object and joints as a scenario that can be probed in simulation.

    Effects that the simulator cannot represent are reported and left out.

    With --format feedforward, writes gravity, inertia and friction of each joint as a table, and as a Python
    and a C function of the desired motion.

    With --format mjcf or urdf, writes friction, rotor, spring, gravity and payload of the joints into a copy
    of the file of --patch; with isaaclab or bam, into a file of actuator parameters.

    With --stream, writes recorded data as CSV or Parquet: a stream of a session, its events, or a channel in
    the form that palpate import reads.

    Examples: palpate export stiff.mcap; palpate export swing.csv --format feedforward -o arm.yaml;
    palpate export arm.csv --urdf arm.urdf --format mjcf --patch arm.xml -o better.xml;
    palpate export stiff.mcap --stream tick -o ticks.parquet
    """
    given = [
        name
        for name, value in (("--stream", stream), ("--layout", layout), ("--revision", revision))
        if value
    ]
    if form is not Format.SCENARIO and (stream or layout):
        given.append(f"--format {form}")
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)}: one file is written; choose one of them")
    if layout is not None:
        _export_layout(data.file, layout, out, force=force, as_json=as_json)
        return
    if stream is not None:
        _export_table(data, stream, out, force=force, as_json=as_json)
        return
    place = folder_to_read(data.file, folder)
    study = data.study(None, place)
    path, force = out or place / _FILES[form], force or out is None
    if patch is not None and form in (Format.SCENARIO, Format.FEEDFORWARD):
        raise InputError(f"--patch {patch}: --format {form} patches no file. Valid: mjcf, urdf, bam")
    if form is Format.FEEDFORWARD:
        _export_feedforward(data, study, path, revision or (), force=force, as_json=as_json)
        return
    if form is not Format.SCENARIO:
        output_file(path, force=force, keep=[data.file])
        written = study.export_simulator(path, form.value, patch, revision or [])
        _warn_of_base_models(study, revision or ())
        paths = [str(file) for file in written.files]

        def show_files() -> None:
            for file in written.files:
                print_files(console.stdout(), {form.value: file})
            _print_lines(written.used, written.left_out)

        content = {"file": str(data.file), "format": form.value, "files": paths}
        console.present(
            content | {"used": written.used, "left_out": written.left_out}, show_files, as_json=as_json
        )
        return
    output_file(path, force=force, keep=[data.file])
    before = len(study.revisions)
    kept = study.to_export(revision or ())
    if len(study.revisions) > before:
        remark = "nothing was added to the contact's model yet: the base model is exported"
        console.stderr().print(f"[yellow]{remark}[/yellow] (palpate diagnose --apply adds what is missing)")
    for item in kept:
        _warn_of_misfit(item)
    export = study.export(path, [item.number for item in kept])

    def show() -> None:
        console.stdout().print(f"scenario  [bold]{shown(path)}[/bold]", soft_wrap=True)
        _print_lines(export.used, export.left_out)

    content = {"file": str(data.file), "scenario": str(path), "used": export.used}
    numbers, own = [str(each.number) for each in kept], own_effects(kept)
    again = data.typed(revision=numbers, folder=folder, effect=[*(data.effect or ()), *own])
    steps = [(f"palpate probe --scenario {typed(path)}", "probe the model as if it were the object")]
    if study.source.probed and data.file.is_file():
        twin = f"palpate replay {typed(data.file)} --scenario {typed(path)}"
        steps.append((twin, "repeat the recorded motion on the model"))
    steps.append((f"palpate compare {again}", "compare the model with the measurement"))
    console.present(content | {"left_out": export.left_out}, show, steps, as_json=as_json)


def _export_feedforward(
    data: DataArguments, study: "Study", table: Path, revisions: Sequence[int], *, force: bool, as_json: bool
) -> None:
    """Write the feedforward of the joints as a table with functions in Python and C."""
    if table.suffix not in {".yaml", ".yml"}:
        raise InputError(f"output {table}: a feedforward is written as .yaml, with .py and .c beside it")
    files = {"table": table, "python": table.with_suffix(".py"), "c": table.with_suffix(".c")}
    for file in files.values():
        output_file(file, force=force, keep=[data.file])
    made = study.export_feedforward(table, list(revisions))
    _warn_of_base_models(study, revisions)

    def show() -> None:
        print_files(console.stdout(), files)
        _print_lines(made.used, made.left_out)

    paths = {name: str(file) for name, file in files.items()}
    content = {"file": str(data.file), **paths, "used": made.used, "left_out": made.left_out}
    console.present(content, show, as_json=as_json)


def _warn_of_misfit(revision: Revision) -> None:
    """Warn of a model that leaves more than the noise: a simulation with it differs from the data."""
    times = revision.rmse / revision.noise_floor if revision.noise_floor > 0.0 else math.inf
    if times >= NOISE:
        name = " + ".join([revision.model, *revision.effects])
        remark = f"{revision.channel}: {name} leaves an error of {times:.3g} times the noise"
        console.stderr().print(
            f"[yellow]{safe(remark)}[/yellow]; a simulation with it differs from the measurement"
        )


def _warn_of_base_models(study: "Study", revisions: Sequence[int]) -> None:
    """Warn of joints without a revision, whose base models were written."""
    chosen = {study.revision(number).channel for number in revisions}
    plain = [
        item.name
        for item in study.channels
        if item.kind is not ChannelKind.CONTACT and item.name not in chosen and study.newest(item) is None
    ]
    if plain:
        remark = f"no effect was added to {', '.join(plain)}: the base model is exported"
        console.stderr().print(f"[yellow]{remark}[/yellow] (palpate diagnose --apply adds what is missing)")


def _export_table(data: DataArguments, name: str, out: Path | None, *, force: bool, as_json: bool) -> None:
    """Write a stream or channel, by default into the session's folder of results."""
    existing_data(data.file)
    path = out or derived_folder(data.file) / f"{name}.csv"
    check_ending(path)
    table = recorded_table(data.file, data.options, name)
    write_table(table, output_file(path, force=force or out is None, keep=[data.file]))
    columns = table.column_names
    content = {"file": str(data.file), "stream": name, "table": str(path), "columns": columns}
    size = f"{count(table.num_rows, 'row')}, {count(table.num_columns, 'column')}"
    is_measurement = "displacement_m" in columns or any("torque_Nm" in column for column in columns)
    console.present(
        content,
        lambda: console.stdout().print(f"table  [bold]{shown(path)}[/bold]: {size}", soft_wrap=True),
        [(f"palpate import {typed(path)}", "import it as a measurement")] if is_measurement else [],
        as_json=as_json,
    )


def _export_layout(file: Path, program: Program, out: Path | None, *, force: bool, as_json: bool) -> None:
    """Write a viewer's layout, by default into the session's folder of results."""
    session = open_session(file)
    path = out or derived_folder(file) / f"{program}{LAYOUT_ENDINGS[program]}"
    text = layout_of(session, program)
    write_text(output_file(path, force=force or out is None, keep=[file]), text)
    if as_json:
        console.print_json({"file": str(file), "layout": str(path), "program": str(program)})
        return
    console.stdout().print(f"layout  [bold]{shown(path)}[/bold]", soft_wrap=True)
    advice = f"open {shown(file)} in {PROGRAMS[program]}, and then this layout"
    long = [stream for name in session.stream_names if (stream := session.samples(name).stream).batch > 1]
    if long:
        advice += f"; it shows every {long[0].batch}th sample (palpate inspect draws the peaks of all)"
    console.stderr().print(advice, soft_wrap=True)


def _print_lines(used: Sequence[str], left_out: Sequence[str]) -> None:
    for line in used:
        console.stdout().print(f"  [green]in[/green]   {safe(line)}")
    for line in left_out:
        console.stdout().print(f"  [yellow]out[/yellow]  {safe(line)}")


@takes_data
def report_command(
    data: DataArguments,
    *,
    model: ModelOption = None,
    folder: FolderOption = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Page to write.", metavar="FILE.html")] = Path(
        REPORT
    ),
    force: Annotated[
        bool, typer.Option("--force", help="Replace the file even if palpate did not write it.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write measurement, models and diagnosis as one self-contained HTML page.

    palpate report press.csv -o press.html
    """
    path = output_file(out, force=force or is_own_page(out), keep=[data.file])
    study = data.study(model, folder_to_read(data.file, folder))
    with console.stderr().status("fitting and drawing"):
        study.report(path, [f"palpate report {data.typed(model=model, folder=folder)}"])
    if as_json:
        console.print_json({"file": str(data.file), "report": str(path)})
        return
    console.stdout().print(f"report  [bold]{shown(path)}[/bold]", soft_wrap=True)
    console.next_steps((f"palpate workbench {data.typed()}", "an interactive page to try effects on"))
