"""`palpate add`, `remove` and `revisions`: extend a model step by step, and go back."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from palpate.common import console
from palpate.common.files import existing_data, folder_to_fill, folder_to_read, output_folder
from palpate.common.options import JsonOption, effect_names
from palpate.estimation.study import RevisionChange, Revisions
from palpate.estimation.study.channels import ALL_CHANNELS
from palpate.estimation.study.revisions import user_effects_of
from palpate.render.build import NAMES, result_view, write_outcome
from palpate.render.terminal import print_files, print_revisions, print_stages
from palpate.study import Study
from palpate.workflows.data_options import DataArguments, FolderOption, ForceOption, ModelOption, takes_data

_EFFECTS = "Effects to add, in order."
_START = "Continue from this revision instead of the newest."
_OUT = "Write revisions and pictures to this folder."


@takes_data
def add_command(
    data: DataArguments,
    *,
    effects: Annotated[list[str], Argument(help=_EFFECTS, metavar="EFFECT...", autocompletion=effect_names)],
    start: Annotated[int | None, Option("--from", help=_START, metavar="REVISION")] = None,
    fresh: Annotated[bool, Option("--fresh", help="Start again from the base model.")] = False,
    model: ModelOption = None,
    channel: Annotated[str | None, Option(help="Channel to add the effects to, such as joint_2.")] = None,
    as_json: JsonOption = False,
    out: Annotated[Path | None, Option(help=_OUT, metavar="FOLDER")] = None,
    force: ForceOption = False,
) -> None:
    """Add effects, refit, show how the held-out error falls, and save each step as a revision.

    Continues from the newest revision, or from the one given by --from. Updates the report and the recording
    in the revisions folder.
    """
    data.refuse_idle_force(out, force=force)
    folder = output_folder(folder_to_fill(data.file, out, NAMES, force=force))
    study = data.study(model, folder)
    with console.stderr().status("refitting stage by stage"):
        change = study.add(*effects, channel=channel, start=start, fresh=fresh)
    written = _update_report(data, study, change, folder, out)
    newest, kept = change.revisions[-1], data.command_text(folder=out)
    steps = [console.rerun_step(written["recording"])] if "recording" in written else []
    steps.append((f"palpate revisions {kept}", "all revisions"))
    if newest.parent is not None:
        back = f"palpate add {data.command_text(out=out)} EFFECT --from {newest.parent}"
        steps.append((back, "go back, and try another effect"))
    grown = change.result.extended_comparison
    if grown is None or not grown.fits:
        steps.append((f"palpate compare {kept} --revision {newest.number}", "where the model still fails"))
    steps += console.export_steps(kept, [change.result.channel.measured.kind])
    result = replace(change.result, diagnosis=None)
    _present(data, replace(change, result=result), written, steps, as_json=as_json)


_EFFECT_NAME = "Effect to remove."


@takes_data
def remove_command(
    data: DataArguments,
    *,
    effect_name: Annotated[str, Argument(help=_EFFECT_NAME, metavar="EFFECT", autocompletion=effect_names)],
    model: ModelOption = None,
    channel: Annotated[str | None, Option(help="Channel of the effect, such as joint_2.")] = None,
    folder: FolderOption = None,
    as_json: JsonOption = False,
) -> None:
    """Remove an added effect from the newest model, refit, and save the result as a revision.

    Updates the report and the recording in the revisions folder.

    Example:
      palpate remove press.csv bias
    """
    kept_in = folder_to_read(data.file, folder)
    study = data.study(model, kept_in)
    with console.stderr().status("refitting without it"):
        change = study.remove(effect_name, channel)
    written = _update_report(data, study, change, kept_in, folder)
    steps = [(f"palpate revisions {data.command_text(folder=folder)}", "all revisions")]
    _present(data, change, written, steps, as_json=as_json)


def _present(
    data: DataArguments,
    change: RevisionChange,
    written: Mapping[str, Path],
    steps: Sequence[tuple[str, str]],
    *,
    as_json: bool,
) -> None:
    """Print the stages of a changed model and the written files, or its new revisions as JSON."""

    def show() -> None:
        print_stages(console.stdout(), result_view(change.result))
        print_files(console.stdout(), written)

    channel = change.result.channel.name
    content = {"file": str(data.file), "channel": channel, "revisions": change.revisions}
    console.present(content, show, steps, as_json=as_json)


def _update_report(
    data: DataArguments, study: Study, change: RevisionChange, folder: Path, typed_folder: Path | None
) -> dict[str, Path]:
    """Write report and recording with the newest model of each channel; return paths by kind."""
    changed = change.result.channel.name
    results = [change.result if item.channel.name == changed else item for item in study.results()]
    with console.stderr().status("report and recording"):
        judged = [result.channel.name for result in results if result.diagnosis is not None]
        which = judged[0] if len(judged) == 1 else ALL_CHANNELS
        diagnose = data.command_text(out=typed_folder, channel=which)
        commands = [f"palpate diagnose {diagnose}"] if judged else []
        for result in (result for result in results if result.added):
            chosen = {"model": result.channel.model.name, "channel": result.channel.name}
            begun = data.command_text(out=typed_folder, **chosen)
            commands.append(f"palpate add {begun} {' '.join(result.added)} --fresh")
        written = write_outcome(folder, study, results, commands)
    for result in results:
        if result.left_out:
            console.warn(result.reason)
    return written


@takes_data
def revisions_command(data: DataArguments, as_json: JsonOption = False, folder: FolderOption = None) -> None:
    """List the revisions of a measurement's models, with their effects and held-out errors.

    Accepts the options of other commands for reading a data file, but ignores them.
    """
    existing_data(data.file)
    revisions = Revisions(folder_to_read(data.file, folder)).all()
    steps = [(f"palpate diagnose {data.command_text()} --apply", "find what is missing, and add it")]
    if revisions:
        first, newest = revisions[0], {revision.channel: revision for revision in revisions}
        own = user_effects_of([first, *newest.values()])
        numbers = [each.number for each in newest.values()]
        added = data.command_text(out=folder, effect=own)
        last = data.command_text(revision=numbers, folder=folder, effect=own)
        steps = [
            (f"palpate add {added} EFFECT --from {first.number}", "go back to a revision and continue there"),
            (f"palpate compare {last}", "where the newest model fails"),
            (f"palpate export {last}", "as a simulated world"),
        ]

        differing = [
            str(each.number) for each in revisions if each.data_sha256 != newest[each.channel].data_sha256
        ]
        if differing:
            console.warn(
                f"revision {', '.join(differing)}: the data differ from those of the newest revision; the "
                "file or its reading options have changed"
            )

    def show() -> None:
        if revisions:
            print_revisions(console.stdout(), revisions)
        else:
            console.stdout().print("no revisions yet: nothing was added to a model")

    console.present({"file": str(data.file), "revisions": revisions}, show, steps, as_json=as_json)
