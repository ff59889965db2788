"""`palpate compare`: where does the model fail?"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from estimation.comparison import Comparison
from estimation.models import MODELS
from palpate import console
from palpate.data_options import (
    ColumnOption,
    ContextOption,
    FileArgument,
    FolderOption,
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
from palpate.findings.compared import Wanted, compare_wanted, of_revisions
from palpate.findings.derived import derived_folder, folder_to_fill, kept_revisions
from palpate.findings.effect_library import library_with
from palpate.findings.estimation_run import load_material
from palpate.findings.kept_diagnosis import is_same, kept_diagnosis
from palpate.findings.kept_revision import KeptRevision, own_effects
from palpate.findings.story import tell_story
from palpate.findings.subject import (
    model_names,
    only_channel,
    subjects_of,
)
from palpate.render.stories import NAMES as OUTCOME
from palpate.render.stories import as_data, comparison_view, write_json, write_outcome
from palpate.render.terminal import print_comparison
from palpate.render.view import StudyView
from palpate.text.after_comparison import Ways, after_comparison
from palpate.words import safe, shown
from robot_io.errors import InputError

RESULT = "comparison.json"


def command(  # noqa: PLR0917, one parameter an option
    file: FileArgument,
    model: Annotated[
        str | None, typer.Option(help=f"One of {', '.join(MODELS)}; default: what suits each channel.")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Only this channel, such as contact.")] = None,
    revision: Annotated[
        list[int] | None,
        typer.Option(help="What was added, instead of the base model (palpate revisions).", metavar="N"),
    ] = None,
    folder: FolderOption = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            help="Effect of your own that a revision has; its file is run.", metavar="FILE.py:CLASS"
        ),
    ] = None,
    urdf: UrdfOption = None,
    tip_frame: TipFrameOption = None,
    column: ColumnOption = None,
    unit: UnitOption = None,
    where: WhereOption = None,
    context: ContextOption = None,
    fresh_runs: FreshOption = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Write comparison.json and an HTML report here.", metavar="FOLDER")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Put a model beside the measurement: how far off it is, and where it fails first.

    The base model, whatever was added; --revision shows that. All errors are on runs that the fit has not
    seen; the noise floor is what a complete model would leave.
    """
    material = load_material(file, import_options(column, unit, where, context, fresh_runs))
    arm, library = given_arm(urdf, tip_frame, material.arm), library_with(effect)
    shelf, place = kept_revisions(material, folder), derived_folder(material, folder)
    if revision:
        _refuse(model, channel)
        wanted = of_revisions(material, arm, shelf, library, revision)
    else:
        wanted = [Wanted(one) for one in only_channel(subjects_of(material, model, arm), channel)]
    target = folder_to_fill(material, out, (RESULT, *OUTCOME), force=force) if out is not None else None
    if target is not None:
        output_folder(target)
    kept = kept_diagnosis(place, material, arm, library.effects)
    wanted = [replace(one, subject=kept.as_judged(one.subject)) for one in wanted]
    compared, failures = _compare(wanted, lambda one: compare_wanted(one, kept, shelf, library.effects))
    subjects = tuple(one.subject for one in wanted)
    result: dict[str, object] = {
        "file": str(file),
        "model": model_names(subjects),
        "channels": [
            as_data(each) | {"force_ahead_of": list(one.subject.force_ahead_of)} for one, each in compared
        ],
        "failures": failures,
    }
    if as_json:
        console.print_json(result)
    else:
        _print(compared, failures)
    data = {"column": column, "unit": unit, "where": where, "context": context, "fresh-runs": fresh_runs}
    judged_by = {"model": model, "urdf": urdf, "tip-frame": tip_frame}
    numbers = [str(number) for number in revision or ()]
    grown = {"revision": numbers, "folder": folder, "effect": effect}
    again = f"palpate compare {retyped(file, channel=channel, **judged_by, **grown, **data)}"
    if target is not None:
        write_json(result, target / RESULT)
        stories = [tell_story(one.subject, None, one.added, library.effects, kept) for one, _ in compared]
        written = write_outcome(target, material, stories, [again])
        console.stderr().print(f"\nreport  [bold]{shown(written['report'])}[/bold]")
    if as_json:
        return
    zoom = (f"{again} --out FOLDER", "a report to zoom into")
    if numbers:
        kept_too = f"palpate revisions {retyped(file, folder=folder, **data)}"
        console.next_steps((kept_too, "all stages"), zoom)
        return
    newest = [found for one in wanted if (found := shelf.latest(one.subject.channel.name))]
    own = list(dict.fromkeys([*(effect or ()), *own_effects(newest)]))
    last = {"revision": [str(found.number) for found in newest], "effect": own}
    since = {**grown, **last, "urdf": urdf, "tip-frame": tip_frame}
    named = model is not None or urdf is not None
    ways = Ways(
        grown=f"palpate compare {retyped(file, **since, **data)}" if newest else None,
        other=None if named else retyped(file, channel=channel, **data),
        diagnose=retyped(file, channel=channel, **judged_by, **data),
        channel=channel,
    )
    console.next_steps(*after_comparison(subjects, compared, arm, ways), zoom)


def _refuse(model: str | None, channel: str | None) -> None:
    """A revision has a model and a channel already."""
    given = [option for option, value in {"--model": model, "--channel": channel}.items() if value]
    if given:
        raise InputError(f"--revision says channel and model already: leave out {given[0]}")


def _compare(
    wanted: Sequence[Wanted], compare: Callable[[Wanted], Comparison]
) -> tuple[list[tuple[Wanted, Comparison]], dict[str, str]]:
    """Compare each; channels that cannot be judged are told with their reason.

    Raises:
        InputError: none can be judged.
    """
    compared: list[tuple[Wanted, Comparison]] = []
    failures: dict[str, str] = {}
    with console.stderr().status("comparing") as status:
        for one in wanted:
            name = one.subject.channel.name
            status.update(f"comparing {name}")
            try:
                compared.append((one, compare(one)))
            except InputError as error:
                failures[name] = str(error)
    if not compared:
        raise InputError(next(iter(failures.values())))
    return compared, failures


def _print(compared: Sequence[tuple[Wanted, Comparison]], failures: Mapping[str, str]) -> None:
    out = console.stdout()
    views = []
    for one, comparison in compared:
        other = one.revision is not None and not is_same(one.revision.rmse, comparison.rmse)
        notes = (_other_then(one.revision),) if one.revision is not None and other else ()
        views.append(comparison_view(one.subject.channel, comparison, notes))
    print_comparison(out, StudyView("", tuple(views)))
    for reason in failures.values():
        out.print(f"[yellow]{safe(reason)}[/yellow]")


def _other_then(revision: KeptRevision) -> str:
    error = f"{revision.rmse:.3g} {revision.effort_unit}"
    return (
        f"revision {revision.number} was kept with an error of {error}: of other rows, by another force, or "
        "by another version of palpate"
    )
