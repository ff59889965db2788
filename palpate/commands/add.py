"""`palpate add`: add effects to the model, and watch the error fall."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from estimation.models import MODELS
from palpate import console
from palpate.data_options import (
    ColumnOption,
    ContextOption,
    FileArgument,
    ForceOption,
    FreshOption,
    TipFrameOption,
    UnitOption,
    UrdfOption,
    WhereOption,
    given_arm,
    import_options,
    retyped,
)
from palpate.files import output_folder
from palpate.findings.derived import folder_to_fill
from palpate.findings.effect_library import library_with
from palpate.findings.estimation_run import load_material
from palpate.findings.growth import Growth, Wish, grow
from palpate.findings.kept_diagnosis import kept_diagnosis
from palpate.findings.retold import retold
from palpate.findings.revisions import RevisionShelf
from palpate.findings.story import Story
from palpate.findings.subject import ALL_CHANNELS
from palpate.render.stories import NAMES as OUTCOME
from palpate.render.stories import story_view, write_outcome
from palpate.render.terminal import print_files, print_stages
from palpate.text.rerun_step import rerun_step
from palpate.words import safe


def command(  # noqa: PLR0917, one parameter an option
    file: FileArgument,
    effects: Annotated[list[str], typer.Argument(help="Effects to add, in order.", metavar="EFFECT...")],
    start: Annotated[
        int | None,
        typer.Option("--from", help="Continue at this revision, not at the newest.", metavar="REVISION"),
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Begin with the base model again.")] = False,
    model: Annotated[
        str | None,
        typer.Option(
            help=f"Base model: one of {', '.join(MODELS)}; default: that of the newest revision, if any."
        ),
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Where to add them, such as joint_2.")] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Effect of your own that may be added; its file is run.", metavar="FILE.py:CLASS"),
    ] = None,
    urdf: UrdfOption = None,
    tip_frame: TipFrameOption = None,
    column: ColumnOption = None,
    unit: UnitOption = None,
    where: WhereOption = None,
    context: ContextOption = None,
    fresh_runs: FreshOption = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the stages as JSON.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Keep revisions and pictures here.", metavar="FOLDER")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Refit with more effects, show how the held-out error falls, and keep each step as a revision.

    Goes on from the newest revision; --from goes back to another one. Report and pictures are renewed where
    revisions are kept.
    """
    material = load_material(file, import_options(column, unit, where, context, fresh_runs))
    data = {"column": column, "unit": unit, "where": where, "context": context, "fresh-runs": fresh_runs}
    given = {"effect": effect, "urdf": urdf, "tip-frame": tip_frame}
    arm, library = given_arm(urdf, tip_frame, material.arm), library_with(effect)
    folder = folder_to_fill(material, out, OUTCOME, force=force)
    wish = Wish(effects, model, channel, start, fresh)
    shelf = RevisionShelf(folder)
    with console.stderr().status("refitting stage by stage"):
        known = kept_diagnosis(folder, material, arm, library.effects)
        growth = grow(material, arm, shelf, library, wish, known)
        stories = retold(growth.story, material, arm, shelf, library, known)
    with console.stderr().status("report, picture and recording"):
        commands = list(_commands(stories, lambda **how: retyped(file, out=out, **how, **given, **data)))
        written = write_outcome(output_folder(folder), material, stories, commands)
    for story in stories:
        if story.left_out:
            console.stderr().print(f"[yellow]{safe(story.left_out)}[/yellow]")
    if as_json:
        channel_name = growth.story.subject.channel.name
        kept = [revision.model_dump(mode="json") for revision in growth.kept]
        console.print_json({"file": str(file), "channel": channel_name, "revisions": kept})
    else:
        back = retyped(file, out=out, **given, **data)
        beside = retyped(file, folder=out, **given, **data)
        _print(back, retyped(file, folder=out, **data), beside, growth, written)


def _commands(stories: Sequence[Story], typed: Callable[..., str]) -> Iterator[str]:
    """What leads to all of these stories, in order; `typed` writes the file with options."""
    judged = [story.subject.channel.name for story in stories if story.diagnosis is not None]
    if judged:
        yield f"palpate diagnose {typed(channel=judged[0] if len(judged) == 1 else ALL_CHANNELS)}"
    for story in stories:
        if story.added:
            begun = typed(model=story.subject.model.name, channel=story.subject.channel.name)
            yield f"palpate add {begun} {' '.join(story.added)} --fresh"


def _print(back: str, kept: str, beside: str, growth: Growth, written: dict[str, Path]) -> None:
    out = console.stdout()
    print_stages(out, story_view(replace(growth.story, diagnosis=None), growth.numbers))
    print_files(out, written)
    steps = [
        rerun_step(written["recording"]),
        (f"palpate revisions {kept}", "all stages, to go back to"),
        (f"palpate compare {beside} --revision {growth.kept[-1].number}", "where the model still fails"),
        (f"palpate export {kept}", "the improved model as a simulated world"),
    ]
    if growth.parent is not None or len(growth.kept) > 1:
        before = growth.kept[-1].parent
        steps.insert(2, (f"palpate add {back} EFFECT --from {before}", "go back, and try another effect"))
    console.next_steps(*steps)
