"""`palpate export` and `report`: write models, recorded data or a report."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from typer import Option

from palpate.common import console
from palpate.common.console import count, display_path, safe, shell_path
from palpate.common.files import (
    derived_folder,
    existing_data,
    folder_to_read,
    open_session,
    output_file,
    write_text,
)
from palpate.common.options import JsonOption, with_options
from palpate.common.table_files import write_table
from palpate.estimation.channel import ChannelKind
from palpate.estimation.diagnosis import Verdict
from palpate.estimation.study.revisions import user_effects_of
from palpate.export.table import ENDINGS, LAYOUT_ENDINGS, PlotProgram, layout_of, recorded_table
from palpate.render.build import REPORT, is_own_page
from palpate.robot_io.errors import InputError
from palpate.workflows.data_options import DataArguments, FolderOption, ModelOption, takes_data

if TYPE_CHECKING:
    from palpate.estimation.study.channels import StudyChannel
    from palpate.study import Study

SCENARIO, FEEDFORWARD = "scenario.yaml", "feedforward.yaml"
PROGRAMS = {PlotProgram.FOXGLOVE: "Foxglove", PlotProgram.PLOTJUGGLER: "PlotJuggler"}


class Format(StrEnum):
    """File format of the exported models."""

    SCENARIO = "scenario"
    FEEDFORWARD = "feedforward"
    MJCF = "mjcf"
    URDF = "urdf"
    ISAACLAB = "isaaclab"
    BAM = "bam"


# Name of the file that is written by default, and endings by which other programs recognize its content.
_FILES = {
    Format.SCENARIO: (SCENARIO, (".yaml", ".yml")),
    Format.FEEDFORWARD: (FEEDFORWARD, (".yaml", ".yml")),
    Format.MJCF: ("model.xml", (".xml", ".mjcf")),
    Format.URDF: ("arm.urdf", (".urdf", ".xml")),
    Format.ISAACLAB: ("actuators.py", (".py",)),
    Format.BAM: ("bam.json", (".json",)),
}


class _Export(NamedTuple):
    """Result of an export."""

    content: Mapping[str, Any]  # as plain data
    lines: Sequence[str]  # for people: the written files
    steps: Sequence[tuple[str, str]] = ()  # commands to try next, with their purposes
    advice: str = ""  # for people, on stderr


_REVISION = "Export these revisions; default: the newest of each channel."
_FORM = (
    "Output format: a simulated world; joint torques as a table and as functions in Python and "
    "C; or joints for MuJoCo, a URDF, Isaac Lab or BAM."
)
_PATCH = (
    "MJCF, URDF (default: --urdf) or BAM parameter file to copy and complete; the original is not changed."
)
_SERVO_GAIN = "Position gain of the servos (torque / (goal - position)), for data with a goal but no torque."
_STREAM = "Write this stream or channel as a table instead, such as tick, events or contact."
_LAYOUT = "Write a layout file for viewing the session in Foxglove or PlotJuggler."
_OUT = "File to write: scenario or feedforward (.yaml), simulator file, or table (.csv, .parquet)."


@dataclass(frozen=True, kw_only=True)
class ExportOptions(DataArguments):
    """What is exported, as the user typed it."""

    revision: Annotated[list[int] | None, Option(help=_REVISION, metavar="N")] = None
    form: Annotated[Format, Option("--format", help=_FORM)] = Format.SCENARIO
    patch: Annotated[Path | None, Option(help=_PATCH, metavar="FILE")] = None
    servo_gain: Annotated[float | None, Option(help=_SERVO_GAIN, metavar="NM_PER_RAD")] = None
    stream: Annotated[str | None, Option(help=_STREAM)] = None
    layout: Annotated[PlotProgram | None, Option(help=_LAYOUT)] = None
    folder: FolderOption = None
    out: Annotated[Path | None, Option("--out", "-o", help=_OUT, metavar="FILE")] = None
    force: Annotated[bool, Option("--force", help="Replace a file that already exists.")] = False
    as_json: JsonOption = False

    def writable(self, usual: Path, *, endings: Collection[str] = ()) -> Path:
        """Return the file of --out, or the usual one, if it may be written; see `output_file`.

        Args:
            usual: path without --out; an existing file is replaced.
            endings: endings that the name may have; empty for any.
        """
        force = self.force or self.out is None
        return output_file(self.out or usual, force=force, keep=[self.file], endings=endings)


@with_options(ExportOptions, "file")
def export_command(data: ExportOptions) -> None:
    """Export the fitted models of object and joints as a scenario that can be probed in simulation.

    Effects that the simulator cannot represent are reported and omitted.

    With --format feedforward, writes gravity, inertia and friction of each joint as a table, and as a Python
    and a C function of the desired motion.

    With --format mjcf or urdf, writes friction, rotor, spring, gravity and payload of the joints into a copy
    of the file of --patch; with isaaclab or bam, into a file of actuator parameters.

    With --stream, writes recorded data as CSV or Parquet: a stream of a session, its events, or a channel in
    the form that palpate import reads.

    Examples:
      palpate export stiff.mcap
      palpate export swing.csv --format feedforward -o arm.yaml
      palpate export arm.csv --urdf arm.urdf --format mjcf --patch arm.xml -o better.xml
      palpate export stiff.mcap --stream tick -o ticks.parquet
    """
    stream, layout, form = data.stream, data.layout, data.form
    exclusive = {"--stream": stream, "--layout": layout, "--revision": data.revision}
    given = [name for name, value in exclusive.items() if value]
    if form is not Format.SCENARIO and (stream or layout):
        given.append(f"--format {form}")
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)}: only one file is written; give only one of these options")
    if layout is not None:
        text = layout_of(session := open_session(data.file), layout)
        path = data.writable(derived_folder(data.file) / f"{layout}{LAYOUT_ENDINGS[layout]}")
        write_text(path, text)
        advice = f"open {display_path(data.file)} in {PROGRAMS[layout]}, and then this layout"
        streams = [session.samples(name).stream for name in session.stream_names]
        if long := [each for each in streams if each.batch > 1]:
            advice += f"; it shows only every {long[0].batch}th sample (palpate inspect shows all peaks)"
        line = f"layout  [bold]{display_path(path)}[/bold]"
        made = _Export({"layout": path, "program": layout}, [line], advice=advice)
    elif stream is not None:
        existing_data(data.file)
        if data.out is not None and data.out.suffix not in ENDINGS:
            raise InputError(f"output {data.out}: the name of a table must end in {' or '.join(ENDINGS)}")
        table = recorded_table(data.file, data.options, stream)
        path = data.writable(derived_folder(data.file) / f"{stream}.csv")
        write_table(table, path)
        columns = table.column_names
        size = f"{count(table.num_rows, 'row')}, {count(table.num_columns, 'column')}"
        steps = []
        if "displacement_m" in columns or any("torque_Nm" in column for column in columns):
            steps.append((f"palpate import {shell_path(path)}", "import it as a measurement"))
        line = f"table  [bold]{display_path(path)}[/bold]: {size}"
        made = _Export({"stream": stream, "table": path, "columns": columns}, [line], steps)
    else:
        place = folder_to_read(data.file, data.folder)
        study = data.study(None, place)
        is_for_simulator = form not in (Format.SCENARIO, Format.FEEDFORWARD)
        if data.patch is not None and not is_for_simulator:
            valid = "Valid formats: mjcf, urdf, bam"
            raise InputError(f"--patch {data.patch}: --format {form} does not use this option. {valid}")
        if data.servo_gain is not None and not is_for_simulator:
            valid = "only for --format mjcf, urdf, isaaclab or bam"
            raise InputError(f"--servo-gain {data.servo_gain:g}: {valid}")
        export = _export_scenario if form is Format.SCENARIO else _export_joints
        made = export(data, study, place / _FILES[form][0])

    def show() -> None:
        for line in made.lines:
            console.say(line)
        for key, color, heading in (
            ("used", "green", "exported"),
            ("left_out", "yellow", "left out or doubtful"),
        ):
            for term in made.content.get(key, ()):
                console.stdout().print(f"  [{color}]{heading:20}[/]  {safe(term)}")
        if made.advice:
            console.stderr().print(made.advice, soft_wrap=True)

    console.present({"file": str(data.file), **made.content}, show, made.steps, as_json=data.as_json)


def _export_scenario(data: ExportOptions, study: "Study", usual: Path) -> _Export:
    """Write the models as a simulated world, and warn of a model that leaves more than the noise."""
    revisions = data.revision or ()
    path = data.writable(usual, endings=_FILES[Format.SCENARIO][1])
    kept = study.to_export(revisions)
    _warn_of_base_models(study, [study.channel_of(i) for i in kept if not i.effects and not revisions])
    for item in kept:
        try:
            comparison = study.comparison(study.channel_of(item), study.revision(item.number).effects)
        except InputError as error:  # for example, the code of a user's own effect was not given
            console.warn(f"{item.channel}: cannot check whether the model fits: {error}")
            continue
        if not comparison.fits:
            console.warn(
                f"{item.channel}: {comparison.model} does not fit: {comparison.words[0]}",
                " A simulation with this model differs from the measurement.",
            )
    export = study.export(path, [item.number for item in kept])
    numbers, own = [each.number for each in kept], user_effects_of(kept)
    again = data.command_text(revision=numbers, folder=data.folder, effect=[*(data.effect or ()), *own])
    steps = [(f"palpate probe --scenario {shell_path(path)}", "probe the model as if it were the object")]
    if study.source.probed and data.file.is_file():
        twin = f"palpate replay {shell_path(data.file)} --scenario {shell_path(path)}"
        steps.append((twin, "repeat the recorded motion on the model"))
    steps.append((f"palpate compare {again}", "compare the model with the measurement"))
    content = {"scenario": str(path), "used": export.used, "left_out": export.left_out}
    return _Export(content, [f"scenario  [bold]{display_path(path)}[/bold]"], steps)


def _export_joints(data: ExportOptions, study: "Study", usual: Path) -> _Export:
    """Write the models of the joints as a feedforward or for a simulator, and warn of base models."""
    form, revisions, content = data.form, data.revision or [], dict[str, Any]()
    if form is Format.FEEDFORWARD:
        path = data.out or usual
        if path.suffix not in _FILES[form][1]:
            raise InputError(
                f"output {path}: the name of a feedforward table must end in .yaml; .py and .c files are "
                "written beside it"
            )
        files = [("table", path), ("python", path.with_suffix(".py")), ("c", path.with_suffix(".c"))]
        for _, file in files:
            output_file(file, force=data.force or data.out is None, keep=[data.file])
        written = study.export_feedforward(path, revisions)
        content = dict(files)
    else:
        path = data.writable(usual, endings=_FILES[form][1])
        written = study.export_simulator(path, form.value, data.patch, revisions, data.servo_gain)
        files = [(form.value, file) for file in written.files]
        content = {"format": form.value, "files": written.files}
    chosen = {study.revision(number).channel for number in revisions}
    joints = [item for item in study.channels if item.kind is not ChannelKind.CONTACT]
    plain = [item for item in joints if item.name not in chosen and study.newest(item) is None]
    _warn_of_base_models(study, plain)
    lines = [f"{what:<10} [bold]{display_path(file)}[/bold]" for what, file in files]
    return _Export(content | {"used": written.used, "left_out": written.left_out}, lines)


def _warn_of_base_models(study: "Study", channels: Sequence["StudyChannel"]) -> None:
    """Warn of channels to which no effect was added, and say what their diagnosis finds."""
    for channel in channels:
        known, advice = None, ""
        with suppress(InputError):  # a damaged diagnosis, which the export does not need
            known = study.known_diagnosis(channel)
        if known is None or known.accepted:
            finding = f"no effect was added to {channel.name}"
            advice = " (palpate diagnose --apply adds what is missing)"
        elif known.verdict is Verdict.ADEQUATE:
            finding = f"the diagnosis finds {channel.name} adequate"
        else:
            finding = f"the diagnosis of {channel.name} names no effect to add"
        console.warn(f"{finding}, so the base model is exported", advice)


_FORCE = "Replace the file even if palpate did not write it."


@takes_data
def report_command(
    data: DataArguments,
    *,
    model: ModelOption = None,
    folder: FolderOption = None,
    out: Annotated[Path, Option("--out", "-o", help="Page to write.", metavar="FILE.html")] = Path(REPORT),
    force: Annotated[bool, Option("--force", help=_FORCE)] = False,
    as_json: JsonOption = False,
) -> None:
    """Write the measurement, its models and the saved diagnosis to one self-contained HTML page.

    Example:
      palpate report press.csv -o press.html
    """
    path = output_file(out, force=force or is_own_page(out), keep=[data.file], endings=(".html", ".htm"))
    study = data.study(model, folder_to_read(data.file, folder))
    # a diagnosis of a data file is saved only in a folder that is named
    place = folder or (None if study.source.session else derived_folder(data.file))
    diagnose, again = (data.command_text(model=model, out=out) for out in (place, folder))
    with console.stderr().status("fitting and drawing"):
        results = study.results()
        is_diagnosed = any(result.diagnosis for result in results)
        commands = [f"palpate diagnose {diagnose}"] if is_diagnosed else []
        for result in (result for result in results if result.added):
            where = f" --channel {result.channel.name}" if len(results) > 1 else ""
            commands.append(f"palpate add {again} {' '.join(result.added)}{where} --fresh")
        study.report(path, [*commands, f"palpate report {data.command_text(model=model, folder=folder)}"])
    steps = [(f"palpate workbench {data.command_text()}", "an interactive page to try effects on")]
    if not is_diagnosed:
        purpose = "find what is missing; then write the report again"
        steps.insert(0, (f"palpate diagnose {diagnose}", purpose))
    content = {"file": str(data.file), "report": str(path)}
    line = f"report  [bold]{display_path(path)}[/bold]"
    console.present(content, lambda: console.say(line), steps, as_json=as_json)
